"""Runs into result folders with a Slam that knows the answer: files, interruption, bad frames, divergence."""

import json
import shutil
import signal
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch
import trimesh
import yaml
from rich.console import Console

from helpers.box_room import BOX_FRAMES, box_poses
from helpers.nearly_right_slam import DivergingSlam, InterruptedSlam, NearlyRightSlam, run_known
from helpers.visible_files import visible_files
from idfslam.cli.tables import print_evaluation
from idfslam.compute.torch_threads import limit_torch_threads
from idfslam.config import FAST, PAPER, Config, load
from idfslam.datasets import open_recording
from idfslam.errors import DivergedError, RecordingError, ResultError
from idfslam.geometry.trajectory import load_tum
from idfslam.runs import result_folder
from idfslam.runs.evaluate_run import evaluate_folder
from idfslam.runs.keyframes_file import read_keyframes
from idfslam.runs.meter import speed_by_block
from idfslam.runs.run_config import RecordingSource, read_config
from idfslam.runs.runner import run
from idfslam.storage import atomic_files


def test_a_run_writes_every_file(box_recording: Path, tmp_path: Path) -> None:
    done = run_known(box_recording, tmp_path / "out")
    assert visible_files(tmp_path / "out") == sorted(result_folder.FILES)
    trajectory = load_tum(tmp_path / "out" / result_folder.TRAJECTORY)
    assert len(trajectory) == BOX_FRAMES
    assert np.allclose(trajectory.timestamps, np.arange(BOX_FRAMES) / 30, atol=1e-6)
    assert np.allclose(trajectory.poses, done.trajectory.poses, atol=1e-8)
    assert len(trimesh.load_mesh(tmp_path / "out" / result_folder.MESH).faces) == 12


def test_metrics(box_recording: Path, tmp_path: Path) -> None:
    run_known(box_recording, tmp_path)
    metrics = json.loads((tmp_path / result_folder.METRICS).read_text())
    assert (metrics["schema"], metrics["frames"]) == (1, BOX_FRAMES)
    assert json.loads((tmp_path / result_folder.KEYFRAMES).read_text())["schema"] == 1
    assert (metrics["keyframes"], metrics["lost_frames"], metrics["unreadable_frames"]) == (3, 0, 0)  # keyframes 0, 5, 10
    assert metrics["ms_per_frame"] == {"track": pytest.approx(2.0), "map": pytest.approx(5.0)}  # 70 ms on 14 frames
    # half of the frames 1 cm beside the others: aligned, every frame is off by at most 5 mm
    assert 0 < metrics["ate_m"]["rmse"] <= 0.005
    assert metrics["frames_per_second"] > 0
    assert len(metrics["frames_per_second_by_100"]) == 1
    assert metrics["peak_memory_mb"] > metrics["peak_memory_above_imports_mb"] >= 0
    assert metrics["interrupted"] is False


def test_config_tells_values_recording_and_versions(box_recording: Path, tmp_path: Path) -> None:
    run_known(box_recording, tmp_path)
    config, source = read_config(tmp_path)
    assert config == load(tmp_path / result_folder.CONFIG) == FAST
    assert source == RecordingSource(str(box_recording))
    assert {"idf-slam", "python", "torch"} <= yaml.safe_load((tmp_path / result_folder.CONFIG).read_text())["versions"].keys()


def test_keyframes_come_back_as_written(box_recording: Path, tmp_path: Path) -> None:
    run_known(box_recording, tmp_path)
    record = read_keyframes(tmp_path)
    assert record.indices.tolist() == [0, 5, 10]
    assert np.allclose(record.timestamps, np.array([0, 5, 10]) / 30)
    assert np.allclose(record.poses[1], box_poses()[5])
    assert record.camera == open_recording(box_recording).camera


def test_the_evaluation_finds_the_recordings_own_truth(box_recording: Path, tmp_path: Path) -> None:
    run_known(box_recording, tmp_path)
    evaluation = evaluate_folder(tmp_path)
    assert evaluation.ate is not None
    assert 0 < evaluation.ate.translation.rmse <= 0.005
    assert evaluation.mesh is None
    assert all((tmp_path / name).is_file() for name in result_folder.EVALUATION_FILES)


def test_the_table_names_its_units(box_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run_known(box_recording, tmp_path)
    print_evaluation(evaluate_folder(tmp_path), tmp_path, Console(width=120))
    assert "ATE [cm], 14 frames" in capsys.readouterr().out


def test_the_evaluation_takes_truth_from_files(box_recording: Path, tmp_path: Path) -> None:
    run_known(box_recording, tmp_path)
    truth = tmp_path / "truth.ply"
    trimesh.creation.box((3.0, 2.2, 3.6)).export(truth)
    evaluation = evaluate_folder(tmp_path, gt=tmp_path / result_folder.TRAJECTORY, gt_mesh=truth, protocol="nice")
    assert evaluation.ate is not None
    assert evaluation.mesh is not None
    assert evaluation.ate.translation.rmse < 1e-7
    assert evaluation.mesh.completion_ratio == 1  # the mesh is the truth


def test_an_unreadable_frame_is_reported_and_lost(box_recording: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    recording = shutil.copytree(box_recording, tmp_path / "bad")
    (recording / "depth" / "0004.png").write_bytes(b"no image")
    run_known(recording, tmp_path / "out")
    assert len(load_tum(tmp_path / "out" / result_folder.TRAJECTORY)) == BOX_FRAMES
    metrics = json.loads((tmp_path / "out" / result_folder.METRICS).read_text())
    assert (metrics["lost_frames"], metrics["unreadable_frames"]) == (1, 1)
    assert len(caplog.records) == 1
    assert "the frame is treated as lost" in caplog.text


def test_ctrl_c_writes_the_results_so_far(box_recording: Path, tmp_path: Path) -> None:
    usual = signal.getsignal(signal.SIGINT)
    done = run_known(box_recording, tmp_path, InterruptedSlam)
    assert len(done.trajectory) == 4  # frames 0 to 3: the one in hand is finished
    assert done.metrics["interrupted"] is True
    assert visible_files(tmp_path) == sorted(result_folder.FILES)
    assert signal.getsignal(signal.SIGINT) is usual
    assert evaluate_folder(tmp_path).frames == 4


def test_divergence_keeps_the_poses(box_recording: Path, tmp_path: Path) -> None:
    with pytest.raises(DivergedError, match="keyframe 6"):
        run_known(box_recording, tmp_path, DivergingSlam)
    assert len(load_tum(tmp_path / result_folder.TRAJECTORY)) == 6
    assert visible_files(tmp_path) == sorted(
        {*result_folder.FILES} - {result_folder.MESH, result_folder.MAP, result_folder.ARCHIVE, result_folder.METRICS}
    )


def test_a_recording_without_any_usable_frame_is_an_error(tmp_path: Path, box_recording: Path) -> None:
    recording = shutil.copytree(box_recording, tmp_path / "bad")
    opened = open_recording(recording)
    for path in (recording / "depth").iterdir():
        cv2.imwrite(str(path), np.zeros((120, 160), np.uint16))
    with pytest.raises(RecordingError, match="none of 14 frames has depth"):
        run(opened, FAST, tmp_path / "out", make_slam=NearlyRightSlam)


def test_a_folder_that_cannot_be_written_to_is_refused_before_the_run(box_recording: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")

    def never(config: Config) -> Any:
        raise AssertionError("the run was begun")

    with pytest.raises(ResultError, match="choose another folder with --out"):
        run_known(box_recording, tmp_path / "file" / "out", never)


def test_replacing_keeps_the_old_file_when_writing_fails(tmp_path: Path) -> None:
    path = tmp_path / "file.txt"
    path.write_text("old")
    with pytest.raises(OSError, match="disk full"), atomic_files.replacing(path) as part:
        part.write_text("ne")
        raise OSError("disk full")
    assert path.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["file.txt"]


def test_json_of_what_is_no_number(tmp_path: Path) -> None:
    atomic_files.write_json(tmp_path / "a.json", {"a": float("nan"), "b": np.float64(2.5), "c": np.arange(2), "d": [np.inf]})
    assert json.loads((tmp_path / "a.json").read_text()) == {"a": None, "b": 2.5, "c": [0, 1], "d": [None]}


def test_damaged_result_files_are_named(tmp_path: Path) -> None:
    (tmp_path / result_folder.KEYFRAMES).write_text('{"keyframes": [{"index": 1}]}')
    (tmp_path / result_folder.CONFIG).write_text("recording: {place: here}")
    with pytest.raises(ResultError, match=r"keyframes\.json"):
        read_keyframes(tmp_path)
    with pytest.raises(ResultError, match="'recording' is"):
        read_config(tmp_path)
    for value in ("start: two", "camera: {fx: wide}", "frames: true", "truth: 1", "path: 5"):
        (tmp_path / result_folder.CONFIG).write_text(f"recording: {{{value if 'path' in value else 'path: here, ' + value}}}")
        with pytest.raises(ResultError, match=f"'{value.split(':')[0]}' of the recording is .*, expected"):
            read_config(tmp_path)
    with pytest.raises(ResultError, match=r"has no mesh\.ply \(found keyframes\.json, config\.yaml\)"):
        result_folder.existing(tmp_path, result_folder.MESH)


def test_speed_by_block() -> None:
    # 2 frames in 1 s, 2 in 4 s, 1 in 0.5 s
    assert speed_by_block([0.5, 1.0, 3.0, 5.0, 5.5], block=2) == [2.0, 0.5, 2.0]
    assert speed_by_block([0.5, 1.0], block=2) == [2.0]
    assert speed_by_block([]) == []


def test_run_leaves_the_number_of_torch_threads_alone(box_recording: Path, tmp_path: Path) -> None:
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        run_known(box_recording, tmp_path)  # FAST, whose map is a grid
        assert torch.get_num_threads() == 2
        limit_torch_threads(PAPER.field.encoding)  # its map is no grid
        assert torch.get_num_threads() == 2
        limit_torch_threads(FAST.field.encoding)
        assert torch.get_num_threads() == 1
    finally:
        torch.set_num_threads(before)
