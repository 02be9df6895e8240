"""A camera that is lost is found again where it has been before, and nowhere else."""

import copy
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
import torch

from idfslam.config import FAST
from idfslam.datasets import Selection
from idfslam.datasets.generated.room import SyntheticRoom
from idfslam.frame import Frame, FrameResult, Status
from idfslam.slam import Slam
from idfslam.slam.tracked import Source, Tracked

pytestmark = pytest.mark.slow

DARK = range(40, 44)
ORDER = [*range(40), *(-1 for _ in DARK), *range(2, 12)]  # half a tour, darkness, and near the start again


@pytest.fixture(scope="module")
def room() -> Selection:
    return Selection(SyntheticRoom(seed=0, frames=240, width=320, height=240), frames=40, stride=3)


def shown(room: Selection, index: int) -> Frame:
    """The frame of the walk with that index."""
    frame = Frame.blank(0, 0.0, room.camera) if ORDER[index] < 0 else room[ORDER[index]]
    return replace(frame, index=index, timestamp=index / 30, depth_timestamp=None)


@pytest.fixture(scope="module")
def kidnapped(room: Selection) -> tuple[Slam, list[FrameResult]]:
    """After the walk; not to be changed."""
    slam = Slam(FAST)
    return slam, [slam.process(shown(room, i)) for i in range(len(ORDER))]


@pytest.fixture
def another(kidnapped: tuple[Slam, list[FrameResult]], room: Selection) -> Slam:
    """A Slam in the state after the walk, which a test may change."""
    slam = Slam(FAST)
    slam.restore(copy.deepcopy(kidnapped[0].state()), lambda index: shown(room, index))
    return slam


def test_the_camera_is_found_at_once(kidnapped: tuple[Slam, list[FrameResult]], room: Selection) -> None:
    slam, results = kidnapped
    assert [r.index for r in results if r.status is Status.LOST] == list(DARK)
    assert room.ground_truth is not None
    seen = np.delete(np.arange(len(ORDER)), DARK)
    truth = (np.linalg.inv(room.ground_truth[0]) @ room.ground_truth)[np.delete(ORDER, DARK)]
    assert np.linalg.norm(truth[40, :3, 3] - truth[39, :3, 3]) > 1.0
    np.testing.assert_allclose(slam.trajectory()[seen, :3, 3], truth[:, :3, 3], atol=0.02)


def test_where_it_was_found_is_no_motion(room: Selection) -> None:
    """The frame after a jump of a metre is expected where the last one was, not a metre farther on."""
    slam = Slam(FAST)
    blank = Frame.blank(0, 0.0, room.camera)
    for i, j in enumerate((0, 1, 2, 30, -1, 1)):
        result = slam.process(replace(blank if j < 0 else room[j], index=i, timestamp=i / 30, depth_timestamp=None))
    assert result.status is Status.OK
    torch.testing.assert_close(slam.motion.T_step, torch.eye(4, dtype=torch.float64))
    np.testing.assert_array_equal(slam._predicted_pose().numpy(), result.T_wc)


def test_the_gap_is_filled_and_marked(kidnapped: tuple[Slam, list[FrameResult]]) -> None:
    slam, _ = kidnapped
    assert [i for i, status in enumerate(slam.statuses()) if status is Status.INTERPOLATED] == list(DARK)
    before, *gap, after = slam.trajectory()[DARK[0] - 1 : DARK[-1] + 2, :3, 3]
    along = [np.dot(p - before, after - before) / np.dot(after - before, after - before) for p in gap]
    assert np.all(np.diff([0, *along, 1]) > 0)


def test_a_view_is_found_by_its_looks_alone(another: Slam, room: Selection) -> None:
    slam, before = another, another.figures()["relocalisations"]
    assert room.ground_truth is not None
    truth = np.linalg.inv(room.ground_truth[0]) @ room.ground_truth
    for j in (5, 20, 35):
        view = slam._view(room[j], torch.eye(4, dtype=torch.float64))  # the predicted pose does not matter
        found = slam.recovery.recover(view, Tracked(view.T_wk, Status.LOST, Source.PREDICTED))
        assert found.source is Source.RELOCALISED
        np.testing.assert_allclose(found.T_wc[:3, 3], truth[j, :3, 3], atol=0.02)
        assert slam.graph.last_keyframe in slam.graph.keyframes
    assert slam.figures()["relocalisations"] == before + 3


def elsewhere(first: int, count: int) -> Iterator[Frame]:
    other = SyntheticRoom(seed=5, frames=240, width=320, height=240)
    for i in range(count):
        yield replace(other[10 * i], index=first + i, timestamp=(first + i) / 30, depth_timestamp=None)


def test_a_place_never_seen_is_not_taken_for_one_that_was(room: Selection) -> None:
    slam = Slam(FAST)
    for i in range(30):
        slam.process(room[i])
    known = [k.index for k in slam.graph.keyframes]
    slam.process(Frame.blank(30, 1.0, room.camera))
    strange = [slam.process(frame) for frame in elsewhere(31, 10)]
    assert [r.status for r in strange] == [Status.LOST] * 10
    assert [k.index for k in slam.graph.keyframes] == known  # nothing of it is mapped
    back = slam.process(replace(room[20], index=41, timestamp=41 / 30))
    assert back.status is Status.OK
    np.testing.assert_allclose(back.T_wc[:3, 3], slam.trajectory()[20, :3, 3], atol=0.01)
