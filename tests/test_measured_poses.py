"""Poses that no image gave are told apart from measured ones: in figures by hand, and in a whole run that begins without depth."""

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from rich.console import Console

from helpers.box_room import BOX_FRAMES, write_box_recording
from helpers.recordings import write_folder
from helpers.small_config import small
from idfslam.cli import command_line
from idfslam.cli.tables import print_evaluation, print_run
from idfslam.datasets import open_recording
from idfslam.errors import ResultError
from idfslam.evaluation.evaluate import evaluate_poses
from idfslam.frame import FrameResult, Status
from idfslam.geometry.trajectory import Trajectory, load_tum
from idfslam.runs.evaluate_run import evaluate_folder
from idfslam.runs.finished_run import FinishedRun
from idfslam.runs.frame_log import FrameLog
from idfslam.runs.lost_frames import leave_out_lost, of_all_frames
from idfslam.runs.run_config import RecordingSource, read_config, write_config
from idfslam.runs.runner import run
from idfslam.runs.source import open_source, read_frames


def at(positions: list[float]) -> np.ndarray:
    poses = np.tile(np.eye(4), (len(positions), 1, 1))
    poses[:, 0, 3] = positions
    return poses


def test_which_statuses_are_measured() -> None:
    assert [status for status in Status if status.measured] == [Status.OK, Status.DEGENERATE, Status.DOUBTFUL]


def test_errors_of_measured_frames_by_hand() -> None:
    """Two frames at the origin by convention, then the true motion: alone it has no error."""
    truth, estimate = at([0, 1, 2, 3, 4]), at([2, 2, 2, 3, 4])
    measured = np.array([False, False, True, True, True])
    errors = evaluate_poses(estimate, truth, measured=measured)
    # deviations from the means 2 and 2.6: -2 -1 0 1 2 and -.6 -.6 -.6 .4 1.4: differences 1.4 .4 -.6 -.6 -.6, squares sum to 3.2
    assert errors.ate.translation.rmse == pytest.approx((3.2 / 5) ** 0.5)
    assert errors.measured is not None and errors.measured.frames == 3
    assert errors.measured.ate.translation.rmse == pytest.approx(0, abs=1e-12)
    assert [len(rpe.frames) for rpe in errors.measured.rpe] == [2]  # pairs of two measured frames
    written = errors.to_dict()["measured"]
    assert (written["frames"], written["frames_with_truth"], written["rpe_1"]["pairs"]) == (3, 3, 2)
    assert evaluate_poses(estimate, truth, measured=np.zeros(5, bool)).measured is None


@pytest.mark.slow
def test_a_run_that_begins_without_depth(tmp_path: Path, capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture) -> None:
    path = write_box_recording(tmp_path / "box")
    for file in sorted((path / "depth").iterdir())[:5]:
        assert cv2.imwrite(str(file), np.zeros_like(cv2.imread(str(file), cv2.IMREAD_UNCHANGED)))
    source = RecordingSource(str(path))
    done = run(open_source(source), small(), tmp_path / "out", source=source)
    statuses = FinishedRun(tmp_path / "out").statuses
    assert statuses[:5] == [Status.LOST] * 5 and statuses[5].measured
    assert len(done.trajectory) == len(statuses) and np.array_equal(done.trajectory.poses[:5], np.tile(np.eye(4), (5, 1, 1)))
    written = json.loads((tmp_path / "out/metrics.json").read_text())
    assert written["measured"]["frames"] == len(statuses) - 5
    assert written["measured"]["ate_m"]["rmse"] < written["ate_m"]["rmse"]
    print_run(done, Console(width=150))
    assert f"cm over the {len(statuses) - 5} frames with a measured pose" in capsys.readouterr().out
    evaluation = evaluate_folder(tmp_path / "out")
    assert evaluation.measured is not None
    assert evaluation.measured.ate.translation.rmse == pytest.approx(
        written["measured"]["ate_m"]["rmse"], abs=1e-6
    )  # trajectory.txt rounds
    print_evaluation(evaluation, tmp_path / "out", Console(width=150))
    assert "frames with a measured pose" in capsys.readouterr().out
    assert "box: 5 frames have no depth; frames.csv says how the pose of each was found" in caplog.messages
    assert written["unreadable_frames"] == 0  # their colour is fine


def test_unreadable_frames_are_a_bounded_number_of_warnings(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = write_folder(tmp_path / "room", frames=60)
    recording = open_recording(path)
    for i in range(2, 52):
        (path / f"depth/{i:06d}.png").unlink()
    frames = list(read_frames(recording))
    assert [readable for _, readable in frames] == [True] * 2 + [False] * 50 + [True] * 8
    assert len(caplog.messages) == 4
    assert caplog.messages[2].endswith("the frame is treated as lost; further ones are counted at the end")
    assert caplog.messages[3] == "room: 50 frames could not be read and are treated as lost"


def test_the_evaluation_tells_measured_poses_apart(known_run: Path, tmp_path: Path) -> None:
    """Frames 4 and 5 of the known run are lost and interpolated."""
    folder = shutil.copytree(known_run, tmp_path / "out")
    written = evaluate_folder(folder).to_dict()
    assert (written["frames"], written["measured"]["frames"]) == (BOX_FRAMES, BOX_FRAMES - 2)
    (folder / "frames.csv").unlink()
    assert "measured" not in evaluate_folder(folder).to_dict()  # an older result folder: nobody knows


def test_a_protocol_without_a_true_mesh_is_told(known_run: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    folder = shutil.copytree(known_run, tmp_path / "out")
    assert evaluate_folder(folder, protocol="nice").mesh is None
    expected = f"{folder}: --protocol nice needs a true mesh, and there is none: give --gt-mesh; only the poses are evaluated"
    assert caplog.messages == [expected]
    caplog.clear()
    evaluate_folder(folder)
    assert not caplog.messages


def test_truth_that_a_run_left_unread(known_run: Path, box_recording: Path, tmp_path: Path) -> None:
    """It is in config.yaml, so that a resumed run leaves it unread too; `eval` reads it."""
    folder, source = shutil.copytree(known_run, tmp_path / "out"), RecordingSource(str(box_recording), truth=False)
    write_config(folder, read_config(folder)[0], source)
    assert read_config(folder)[1] == source and open_source(source).ground_truth is None
    assert evaluate_folder(folder).ate.translation.rmse < 1e-6
    command = command_line.parse(["run", "room", "--no-truth"])
    assert isinstance(command, command_line.Run) and not command.truth


def test_no_truth_at_all_is_one_line(known_run: Path, box_recording: Path, tmp_path: Path) -> None:
    folder, recording = shutil.copytree(known_run, tmp_path / "out"), shutil.copytree(box_recording, tmp_path / "box")
    shutil.rmtree(recording / "pose")
    write_config(folder, read_config(folder)[0], RecordingSource(str(recording)))
    with pytest.raises(ResultError, match="its recording has no ground truth; give one with --gt"):
        evaluate_folder(folder)


def test_a_trajectory_without_lost_frames(known_run: Path, tmp_path: Path) -> None:
    """Frames 4 and 5 of the known run are left out; all other commands still know all frames by their numbers."""
    folder = shutil.copytree(known_run, tmp_path / "out")
    whole = FinishedRun(folder).trajectory
    assert len(leave_out_lost(folder)) == BOX_FRAMES - 2
    kept = np.setdiff1d(np.arange(BOX_FRAMES), [4, 5])
    listed = load_tum(folder / "trajectory.txt")
    assert np.array_equal(listed.timestamps, whole.timestamps[kept]) and np.array_equal(listed.poses, whole.poses[kept])
    run_again = FinishedRun(folder)
    assert len(run_again.trajectory) == BOX_FRAMES and np.array_equal(run_again.trajectory.poses[kept], whole.poses[kept])
    assert np.array_equal(run_again.trajectory.poses[[4, 5]], whole.poses[[3, 3]])
    assert run_again.listed.tolist() == kept.tolist() and len(run_again.measured) == BOX_FRAMES
    errors = evaluate_folder(folder)
    leave_out_lost(folder)  # a second time changes nothing
    assert np.array_equal(load_tum(folder / "trajectory.txt").poses, listed.poses)
    assert errors.frames == BOX_FRAMES - 2 and errors.measured is not None and errors.measured.frames == BOX_FRAMES - 2


def test_frames_before_the_first_measured_one_have_its_pose() -> None:
    log = FrameLog()
    for i, status in enumerate([Status.LOST, Status.LOST, Status.OK, Status.LOST, Status.DEGENERATE]):
        log.add(FrameResult(i, i / 10, np.eye(4), status, keyframe=False, losses={}), ms=1.0)
    listed = Trajectory(np.array([0.2, 0.4]), at([7, 8]))
    trajectory, indices = of_all_frames(listed, log)
    assert indices.tolist() == [2, 4] and trajectory.positions[:, 0].tolist() == [7, 7, 7, 7, 8]
    assert trajectory.timestamps == pytest.approx([0, 0.1, 0.2, 0.3, 0.4])
    assert of_all_frames(listed, None)[0] is listed
