"""A gripper in view from the first frame on: it does not draw the pose along, and it is no part of the map."""

import copy
from dataclasses import dataclass, replace

import numpy as np
import pytest

from helpers.differences import differences
from idfslam.config import FAST
from idfslam.datasets.generated.room import SyntheticRoom
from idfslam.frame import Frame, FrameResult, Status
from idfslam.slam import Slam
from idfslam.slam.motion_segmentation.motion_segmentation import FreeSpaceSegmentation
from idfslam.storage.state import State

FRAMES, LEFT = 16, 12  # in the last frames the gripper has left
V, U = np.mgrid[:240, :320]
OFF = ((U - 205) / 95) ** 2 + ((V - 245) / 110) ** 2
GRIPPER = OFF < 1


def gripped(frame: Frame) -> Frame:
    """The frame with a gripper in a fifth of the image, 45 to 57 cm away."""
    skin = (0.45 + 0.25 * np.sin(U / 5 + 2 * np.sin(V / 9)) * np.cos(V / 6))[..., None].repeat(3, -1)
    noise = 0.0015 * np.random.default_rng(frame.index).standard_normal(OFF.shape)
    colour, depth = np.where(GRIPPER[..., None], skin, frame.colour), np.where(GRIPPER, 0.45 + 0.12 * OFF + noise, frame.depth)
    return replace(frame, colour=colour.astype(np.float32), depth=depth.astype(np.float32))


@dataclass(frozen=True)
class Run:
    """A run, not to be changed."""

    frames: list[Frame]
    truth: np.ndarray
    slam: Slam
    results: list[FrameResult]
    state_at_8: State


@pytest.fixture(scope="module")
def run() -> Run:
    room = SyntheticRoom(8, FRAMES, 320, 240, noise=True)
    frames = [gripped(room[i]) if i < LEFT else room[i] for i in range(FRAMES)]
    slam, results, state = Slam(FAST), list[FrameResult](), State()
    for frame in frames:
        if frame.index == 8:
            state = copy.deepcopy(slam.state())
        results.append(slam.process(frame))
    return Run(frames, np.linalg.inv(room.ground_truth[0]) @ room.ground_truth, slam, results, state)


@pytest.mark.slow
def test_a_gripper_does_not_draw_the_pose_along(run: Run) -> None:
    """Before it was known, poses were off by 10 cm after 8 frames, and degenerate; then they jumped back."""
    off = [float(np.linalg.norm((result.T_wc - T_wc)[:3, 3])) for result, T_wc in zip(run.results, run.truth)]
    assert max(off) < 0.015
    assert {result.status for result in run.results} == {Status.OK}


@pytest.mark.slow
def test_it_is_hidden_until_it_has_left(run: Run) -> None:
    for result in run.results[1:LEFT]:
        assert result.moving is not None
        assert result.moving[GRIPPER].mean() > 0.95
        assert result.moving[~GRIPPER].mean() < 0.05
    assert run.results[-1].moving is None
    first = run.slam.graph.keyframes[0]
    assert first.moving is not None
    assert first.moving[GRIPPER].mean() > 0.95  # the map has learnt it without


@pytest.mark.slow
def test_a_restored_run_hides_what_the_unbroken_one_hides(run: Run) -> None:
    again = Slam(FAST)
    again.restore(copy.deepcopy(run.state_at_8), lambda i: run.frames[i])
    for frame in run.frames[8:]:
        one, other = run.results[frame.index], again.process(frame)
        np.testing.assert_array_equal(one.T_wc, other.T_wc)
        np.testing.assert_array_equal(one.moving, other.moving)
    assert isinstance(run.slam.segmentation, FreeSpaceSegmentation)
    assert isinstance(again.segmentation, FreeSpaceSegmentation)
    assert list(differences(run.slam.segmentation.carried, again.segmentation.carried, "carried")) == []
