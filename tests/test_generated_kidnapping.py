"""Kidnapping: which frames come when, what the black ones hold, and that runs and evaluations find such a recording."""

import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from idfslam.batch.recordings import RecordingSpec, parse_recordings
from idfslam.cli import command_line
from idfslam.datasets import open_recording
from idfslam.datasets.generated import absolute_path, kind_of
from idfslam.datasets.generated.kidnapped import BLACK, Kidnapped, kidnapped_order
from idfslam.errors import ConfigError, RecordingError
from idfslam.frame import Frame
from idfslam.geometry.camera import Camera
from idfslam.runs.run_config import read_config


class Round:
    """600 frames of 8 x 6 pixels on a circle of radius 1 m, `period` frames once round; the depth says which frame it is."""

    name, camera = "round", Camera(8, 6, 8.0, 8.0, 3.5, 2.5)

    def __init__(self, period: int = 600, count: int = 600) -> None:
        self.timestamps = 7.0 + np.arange(count) / 25
        phi = 2 * np.pi * np.arange(count) / period
        self.ground_truth: NDArray[np.float64] | None = np.tile(np.eye(4), (count, 1, 1))
        self.ground_truth[:, 0, 3], self.ground_truth[:, 1, 3] = np.cos(phi), np.sin(phi)

    def __len__(self) -> int:
        return len(self.timestamps)

    def __getitem__(self, i: int) -> Frame:
        depth = np.full((6, 8), (1 + i) / 8, np.float32)
        return Frame(i, float(self.timestamps[i]), np.ones((6, 8, 3), np.float32), depth, self.camera)

    def surface(self) -> None:
        """Unknown."""


def runs(order: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """The pieces between black frames."""
    black = np.flatnonzero(order == BLACK)
    return [piece[piece != BLACK] for piece in np.split(order, black) if (piece != BLACK).any()]


def test_order_by_hand() -> None:
    """600 frames, 5 times: moments after frames 99, 199, 299, 399 and 499, each shown for the first time."""
    order = Kidnapped(Round()).order
    pieces = runs(order)
    assert len(pieces) == 6
    assert [int(piece[-1]) for piece in pieces] == [99, 199, 299, 399, 499, 599]
    assert pieces[0][0] == 0
    for k in range(1, 6):
        assert 20 * k <= pieces[k][0] < 80 * k  # of 100 k frames seen
    assert all((np.diff(piece) == 1).all() for piece in pieces)
    assert (order == BLACK).sum() == 150
    assert len(order) == 600 + 150 + sum(100 * k - int(pieces[k][0]) for k in range(1, 6))
    assert set(order[order != BLACK].tolist()) == set(range(600))
    np.testing.assert_array_equal(np.flatnonzero(order == BLACK)[:30], np.arange(100, 130))


@given(st.integers(12, 300), st.integers(1, 5), st.integers(1, 4), st.integers(0, 20))
def test_every_frame_is_shown_and_jumps_lead_back(count: int, times: int, frames: int, seed: int) -> None:
    order = kidnapped_order(count, None, times, frames, np.random.default_rng(seed))
    assert set(order[order != BLACK].tolist()) == set(range(count))
    assert (order == BLACK).sum() == times * frames
    pieces, seen = runs(order), 0
    for before, after in pairwise(pieces):
        seen = max(seen, int(before[-1]) + 1)
        assert before[-1] == seen - 1  # the moment is one of something new
        assert 0.2 * seen <= after[0] < 0.8 * seen


def test_the_camera_returns_to_another_place() -> None:
    """Two rounds of 300 frames: after frame 449 the same place comes at 149; within 0.5 m lie 24 frames on either side."""
    for seed in range(30):
        pieces = runs(Kidnapped(Round(period=300), times=3, seed=seed).order)
        for before, after in pairwise(pieces):
            apart = abs(int(before[-1]) - int(after[0])) % 300
            assert min(apart, 300 - apart) >= 25


def test_frames_stamps_and_truth() -> None:
    base = Round()
    dataset = Kidnapped(base, times=2, frames=4, seed=3)
    assert dataset.name == "kidnap-round"
    assert dataset.ground_truth is not None and base.ground_truth is not None
    np.testing.assert_allclose(np.diff(dataset.timestamps), 1 / 25)
    assert dataset.timestamps[0] == 7.0
    for i in range(190, 230):
        frame, shown = dataset[i], int(dataset.order[i])
        assert (frame.index, frame.timestamp) == (i, dataset.timestamps[i])
        if 200 <= i < 204:
            assert shown == BLACK
            assert not frame.depth.any() and not frame.colour.any()
            assert np.isnan(dataset.ground_truth[i]).all()
        else:
            assert (frame.depth == (1 + shown) / 8).all()
            np.testing.assert_array_equal(dataset.ground_truth[i], base.ground_truth[shown])
    assert dataset[-1].depth[0, 0] == 600 / 8
    np.testing.assert_array_equal(dataset.order, Kidnapped(base, times=2, frames=4, seed=3).order)
    assert (dataset.order[204] != Kidnapped(base, times=2, frames=4, seed=4).order[204]).any()
    base.ground_truth = None
    assert Kidnapped(base).ground_truth is None


def test_recordings_too_short() -> None:
    with pytest.raises(ConfigError, match=r"5 kidnappings of 30 black frames in the 11 frames of round, expected .* 12 frames"):
        Kidnapped(Round(count=11))
    with pytest.raises(ConfigError, match="0 kidnappings"):
        Kidnapped(Round(), times=0)


# ----- by name


@pytest.mark.slow
def test_run_and_evaluation_by_name(box_recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A relative path behind kidnap: is found again from another folder; black frames have poses in the result and none in the truth."""
    monkeypatch.chdir(box_recording.parent)
    out, name = tmp_path / "out", f"kidnap:{box_recording.name}"
    flags = ["--frames", "34", "--device", "cpu", "--mesh.resolution", "0.05", "--out", str(out)]
    command_line.main(["run", name, *flags])
    assert len((out / "trajectory.txt").read_text().splitlines()) == 35
    _, source = read_config(out)
    assert source is not None
    assert source.path == f"kidnap:{box_recording.absolute()}"
    monkeypatch.chdir(tmp_path)
    command_line.main(["eval", str(out)])
    metrics = json.loads((out / "metrics.json").read_text())
    assert metrics["lost_frames"] >= 30
    assert metrics["frames"] == 34
    evaluation = json.loads((out / "evaluation.json").read_text())
    assert evaluation["ate_m"]["rmse"] < 0.5


def test_names(box_recording: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(box_recording.parent)
    assert absolute_path("kidnap:synthetic:0") == "kidnap:synthetic:0"
    assert absolute_path(box_recording.name) == str(box_recording)
    assert [kind_of(name) for name in ("corridor", "corridor:3", "corridor:3:kinect:5laps", "corridor:1lap")] == ["corridor"] * 4
    assert [kind_of(name) for name in ("corridor:fine", "corridors", "synthetic:5laps")] == [None] * 3
    first, second = parse_recordings(["kidnap:synthetic:3@50", f"kidnap:{box_recording.name}"])
    assert first == RecordingSpec("kidnap-synthetic-3", "kidnap:synthetic:3", 50)
    assert second == RecordingSpec("kidnap-box", f"kidnap:{box_recording}")
    with pytest.raises(RecordingError, match="nowhere: no such file or folder, expected a recording, synthetic"):
        open_recording("kidnap:nowhere")
    with pytest.raises(
        RecordingError,
        match=r"corridor:fine: not a corridor recording, expected corridor\[:SEED\]\[:people or .*\]\[:kinect or :handheld.*\]\[:Nlaps\]",
    ):
        open_recording("corridor:fine", format="corridor")
    with pytest.raises(ConfigError, match="own camera"):
        open_recording("corridor", camera={"fx": 500.0})


def test_corridors_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    """A stand-in remembers how the corridor would be built: building one takes seconds."""
    built: list[dict] = []

    class Stand(Round):
        def __init__(self, **arguments: int) -> None:
            built.append(arguments)
            super().__init__()

    monkeypatch.setattr("idfslam.datasets.generated.corridor.SyntheticCorridor", Stand)
    assert open_recording("corridor:3:kinect:5laps").name == "round"
    assert len(open_recording("corridor", start=10, frames=20, stride=2)) == 20
    assert open_recording("kidnap:corridor:2laps").name == "kidnap-round"
    assert built == [
        {"seed": 3, "laps": 5, "frames": 0, "noise": True, "movers": None},
        {"seed": 0, "laps": 1, "frames": 49, "noise": False, "movers": None},
        {"seed": 0, "laps": 2, "frames": 0, "noise": False, "movers": None},
    ]
