"""The benchmark of the tracker alone: it follows the box recording without a map, and says what it measured, and what goes wrong."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from idfslam.benchmark import odometry as module
from idfslam.benchmark.odometry import bench_odometry, markdown, odometry
from idfslam.cli.command_line import main
from idfslam.config import FAST
from idfslam.datasets import Dataset, open_recording
from idfslam.errors import ConfigError, DivergedError, RecordingError
from idfslam.frame import Frame, FrameResult
from idfslam.slam import Slam

SMALL = replace(
    FAST,
    keyframes=replace(FAST.keyframes, translation=0.03, rotation=3.0, cull=1.0),
    mapper=replace(FAST.mapper, first_iterations=20, iterations=2),
    finetune=replace(FAST.finetune, every=1, keyframes=3, validate_every=2),
)


@pytest.mark.slow
def test_the_tracker_alone_has_no_map(box_recording: Path) -> None:
    slam = Slam(odometry(SMALL, finetune=False, grid=4))
    tables = slam.mapper.learnt().encoding.tables.clone()
    recording = open_recording(box_recording)
    results = [slam.process(recording[i]) for i in range(len(recording))]
    assert set(slam.timings) <= {"track", "map", "refine", "wait", "loops", "segment", "archive", "resection"}
    assert (tables == slam.mapper.learnt().encoding.tables).all()
    assert not any(result.losses for result in results)
    truth = recording.ground_truth
    assert truth is not None
    relative = np.linalg.inv(truth[0]) @ truth
    assert np.linalg.norm(slam.trajectory()[:, :3, 3] - relative[:, :3, 3], axis=-1).max() < 0.01


@pytest.mark.slow
def test_four_rows_and_as_many_seeds_as_there_is_chance(box_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = bench_odometry([str(box_recording)], SMALL, seeds=2, folder=tmp_path / "out")
    rows = [(row["finetuning"], row["grid"], [run["seed"] for run in row["runs"]]) for row in found["rows"]]
    assert rows == [(False, 4, [0]), (False, 1, [0]), (True, 4, [0, 1]), (True, 1, [0, 1])]
    for row in found["rows"]:
        assert row["summary"]["ate_m"]["mean"] < 0.01
        assert row["summary"]["lost_frames"]["mean"] == 0
        assert row["summary"]["ms_a_frame"]["mean"] > 0
    assert found["rows"][0]["summary"]["ms_finetuning"]["mean"] < found["rows"][2]["summary"]["ms_finetuning"]["mean"]
    assert json.loads((tmp_path / "out" / "odometry.json").read_text())["rows"] == found["rows"]
    assert (tmp_path / "out" / "odometry.md").read_text() == markdown(found)
    assert "| box | finetuned | grid 1 | 2 of 2 |" in markdown(found)


@pytest.mark.slow
def test_the_command(box_recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["bench-odometry", f"{box_recording}@4", "--seeds", "1", "--json"])
    assert len(json.loads(capsys.readouterr().out.splitlines()[-1])["rows"]) == 4


def test_a_run_that_diverges_is_told(box_recording: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Broken(Slam):
        def process(self, frame: Frame) -> FrameResult:
            if self.config.finetune.enabled:
                raise DivergedError("finetuning: the depth loss is nan")
            return super().process(frame)

    monkeypatch.setattr(module, "Slam", Broken)
    said: list[str] = []
    found = bench_odometry([f"{box_recording}@3"], SMALL, seeds=1, report=said.append)
    assert "| box | finetuned | grid 4 | 0 of 1 | - |" in markdown(found)
    assert "Failed: box finetuned grid 4, seed 0: finetuning: the depth loss is nan" in markdown(found)
    assert [("failed" in line) for line in said] == [False, False, True, True]


def test_wrong_input(box_recording: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ConfigError, match="--seeds 0, expected at least 1"):
        bench_odometry([str(box_recording)], SMALL, seeds=0)

    def without_poses(*arguments: object, **options: object) -> Dataset:
        recording = open_recording(box_recording)
        recording.ground_truth = None
        return recording

    monkeypatch.setattr(module, "open_recording", without_poses)
    with pytest.raises(RecordingError, match="box: has no ground truth"):
        bench_odometry([str(box_recording)], SMALL)
