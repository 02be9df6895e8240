"""The whole system on the box recording: repeatable, never losing count of frames, and honest about frames without evidence."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from helpers.small_config import small
from idfslam.datasets import open_recording
from idfslam.errors import ConfigError, FrameError, ResultError
from idfslam.frame import Frame, FrameResult, Status
from idfslam.geometry import se3
from idfslam.slam import Slam

BLANK = (5, 6)  # frames that could not be read


def processed(recording: Path, *, blank: tuple[int, ...] = (), frames: int | None = None) -> tuple[Slam, list[FrameResult]]:
    data, slam = open_recording(recording, frames=frames), Slam(small())
    results = []
    for i in range(len(data)):
        frame = data[i]
        results.append(slam.process(Frame.blank(frame.index, frame.timestamp, data.camera) if i in blank else frame))
    return slam, results


def errors(slam: Slam, recording: Path) -> NDArray[np.float64]:
    """Each frame's distance [m] from the truth."""
    truth = open_recording(recording).ground_truth
    relative = np.linalg.inv(truth[0]) @ truth
    return np.linalg.norm(slam.trajectory()[:, :3, 3] - relative[:, :3, 3], axis=-1)


@pytest.fixture(scope="module")
def run(box_recording: Path) -> tuple[Slam, list[FrameResult]]:
    return processed(box_recording)


@pytest.fixture(scope="module")
def interrupted(box_recording: Path) -> tuple[Slam, list[FrameResult]]:
    return processed(box_recording, blank=BLANK)


def test_it_follows_the_camera(run: tuple[Slam, list[FrameResult]], box_recording: Path) -> None:
    slam, results = run
    assert errors(slam, box_recording).max() < 0.01
    assert all(r.status is not Status.LOST for r in results)
    assert results[0].keyframe
    np.testing.assert_array_equal(results[0].T_wc, np.eye(4))  # the world is the first frame
    assert sum(r.keyframe for r in results) == len(slam.graph.keyframes) >= 3


def test_one_pose_for_every_frame(run: tuple[Slam, list[FrameResult]]) -> None:
    slam, results = run
    trajectory = slam.trajectory()
    assert trajectory.shape == (14, 4, 4)
    assert trajectory.dtype == np.float64
    assert len(results) == len(slam.statuses()) == len(slam.frames) == 14
    assert [r.index for r in results] == list(range(14))
    for R in trajectory[:, :3, :3]:
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-9)


@pytest.mark.slow
def test_two_runs_are_the_same(box_recording: Path) -> None:
    (once, _), (again, _) = processed(box_recording, frames=7), processed(box_recording, frames=7)
    assert np.array_equal(once.trajectory(), again.trajectory())
    assert torch.equal(once.mapper.learnt().encoding.tables, again.mapper.learnt().encoding.tables)


def test_blank_frames_are_lost_and_never_mapped(interrupted: tuple[Slam, list[FrameResult]]) -> None:
    slam, results = interrupted
    assert [r.index for r in results if r.status is Status.LOST] == list(BLANK)
    assert [i for i, status in enumerate(slam.statuses()) if status is Status.INTERPOLATED] == list(BLANK)  # known afterwards
    assert Status.LOST not in slam.statuses()
    for i in BLANK:
        assert not results[i].keyframe
        assert "total" not in results[i].losses
    assert not {k.index for k in slam.graph.keyframes} & set(BLANK)


def test_tracking_goes_on_after_blank_frames(interrupted: tuple[Slam, list[FrameResult]], box_recording: Path) -> None:
    slam, results = interrupted
    assert len(slam.trajectory()) == len(results) == 14
    assert np.isfinite(slam.trajectory()).all()
    assert np.delete(errors(slam, box_recording), BLANK).max() < 0.01


def test_a_blank_first_frame_waits_for_the_map(box_recording: Path) -> None:
    slam, results = processed(box_recording, blank=(0,), frames=4)
    assert not results[0].keyframe
    assert results[1].keyframe
    assert len(slam.trajectory()) == 4
    assert np.isfinite(slam.trajectory()).all()


def test_moving_a_keyframe_moves_its_frames(box_recording: Path) -> None:
    slam, _ = processed(box_recording, frames=6)
    before = slam.trajectory()
    move = se3.exp(torch.tensor([0.1, -0.2, 0.3, 0.0, 0.1, 0.2], dtype=torch.float64))
    keyframe = slam.graph.keyframes[0]
    keyframe.T_wk = move @ keyframe.T_wk
    after = slam.trajectory()
    own = slam.graph.keyframes[1].index if len(slam.graph.keyframes) > 1 else 6  # until the next keyframe they hang on the first
    assert own > 1
    np.testing.assert_allclose(after[:own], move.numpy() @ before[:own], atol=1e-12)
    np.testing.assert_array_equal(after[own:], before[own:])


def test_finish_twice_is_harmless(box_recording: Path) -> None:
    slam, _ = processed(box_recording, frames=3)
    before = slam.mapper.learnt().encoding.tables.detach().clone()
    slam.finish()
    polished, timed = slam.mapper.learnt().encoding.tables.detach().clone(), len(slam.timings["finish"])
    assert not torch.equal(before, polished) and timed > 0
    slam.finish()
    assert torch.equal(slam.mapper.learnt().encoding.tables, polished)
    assert len(slam.timings["finish"]) == timed
    assert slam.trajectory().shape == (3, 4, 4)


def test_without_frames_there_is_nothing() -> None:
    slam = Slam(small())
    slam.finish()
    assert slam.trajectory().shape == (0, 4, 4)
    assert slam.statuses() == []


@pytest.mark.skipif(torch.cuda.is_available(), reason="this machine has a GPU")
def test_a_gpu_that_is_not_there() -> None:
    with pytest.raises(ConfigError, match="--device cuda: this torch finds no CUDA device"):
        Slam(replace(small(), device="cuda"))


def test_frames_that_do_not_continue_the_run_are_refused(box_recording: Path, caplog: pytest.LogCaptureFixture) -> None:
    data, slam = open_recording(box_recording), Slam(small())
    with pytest.raises(FrameError, match=r"frame has index 3, expected 0: number the frames 0, 1, 2 \.\.\. without gaps"):
        slam.process(data[3])
    slam.process(data[0])
    with pytest.raises(FrameError, match="frame has index 0, expected 1"):
        slam.process(data[0])
    with pytest.raises(FrameError, match=r"frame 1 is of Camera.*, expected Camera.* as before: use one camera for a run"):
        slam.process(replace(data[1], camera=replace(data.camera, fx=99.0)))
    slam.process(replace(data[1], timestamp=-1.0))
    slam.process(replace(data[2], timestamp=-2.0))
    assert caplog.messages == ["frame 1 has the time stamp -1.000000 s, expected more than 0.000000 s"]  # once


def test_nothing_mapped_is_said() -> None:
    slam = Slam(small())
    slam.finish()
    for ask in (lambda: slam.mesh(0.02), lambda: slam.save_map(Path("map.safetensors"))):
        with pytest.raises(ResultError, match="nothing is mapped after 0 frames: process at least one frame with depth first"):
            ask()
    for resolution in (0.0, -0.02, float("nan")):
        with pytest.raises(ConfigError, match=r"resolution is .*, expected metres above 0"):
            slam.mesh(resolution)
