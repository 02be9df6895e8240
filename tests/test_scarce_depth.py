"""Frames whose depth leaves a pose unsure come to their places by corners without depth, once frames have told how far away these are."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from idfslam.alignment.alignment import Alignment, expected_error
from idfslam.config import FAST, FinetuneConfig, TrackerConfig
from idfslam.datasets.generated.room import SyntheticRoom
from idfslam.frame import Frame, Status
from idfslam.geometry import se3
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.sensing.rectification import Rectification, RowTimes
from idfslam.slam.front_end.scarce_depth import ScarceDepth
from idfslam.slam.keyframe_adjustment.keyframe_corners import KeyframeCorners
from idfslam.slam.keyframe_features import KeyframeFeatures
from idfslam.tracking.frame_features import brightness
from idfslam.tracking.tracker import Tracker

REACH = 2.8  # [m] of the sensor: the first keyframe has depth on a tenth of its image
SEEN_BEFORE, LAST = range(3, 58, 6), 60  # frames of the room that have told of the corners, and one that is off
OFF = 0.02, 0.005  # [m], [rad] by which it is off, along each axis


@pytest.fixture(scope="module")
def room() -> SyntheticRoom:
    return SyntheticRoom(seed=3, frames=600, width=320, height=240, noise=False)


def true_pose(room: SyntheticRoom, i: int) -> torch.Tensor:
    return torch.from_numpy(np.linalg.inv(room.ground_truth[0]) @ np.asarray(room.ground_truth[i]))


def view_of(room: SyntheticRoom, i: int, T_wc: torch.Tensor) -> Keyframe:
    frame: Frame = room[i]
    frame = replace(frame, depth=np.where(frame.depth < REACH, frame.depth, 0).astype(np.float32))
    return Keyframe(frame, T_wc, torch.from_numpy(frame.depth), torch.from_numpy(frame.colour))


@pytest.fixture(scope="module")
def corners(room: SyntheticRoom) -> KeyframeCorners:
    graph = KeyframeGraph(FAST.keyframes)
    graph.insert(view_of(room, 0, torch.eye(4, dtype=torch.float64)))
    made = KeyframeCorners(graph, KeyframeFeatures(Tracker(TrackerConfig(), FinetuneConfig(enabled=False))))
    made.begin(0)
    for i in SEEN_BEFORE:
        made.narrow(made.search(torch.from_numpy(brightness(room[i])), true_pose(room, i)), true_pose(room, i))
    return made


def aligned(room: SyntheticRoom, *, off: tuple[float, float] = OFF, status: Status = Status.OK) -> Alignment:
    """An alignment of the last frame that is off, as its covariance says."""
    error = se3.exp(torch.tensor([off[0]] * 3 + [off[1]] * 3, dtype=torch.float64))
    covariance = torch.diag(torch.tensor([off[0] ** 2] * 3 + [off[1] ** 2] * 3, dtype=torch.float64))
    return Alignment(true_pose(room, LAST) @ error, status, 1.0, 0.01, 0.1, 0.01, 0.5, None, 5, covariance)


def distance(found: Alignment, room: SyntheticRoom) -> float:
    """[m] from its true place."""
    return float((found.T_wc - true_pose(room, LAST))[:3, 3].norm())


def test_a_frame_that_is_off_comes_to_its_place(room: SyntheticRoom, corners: KeyframeCorners) -> None:
    assert corners.hosts[0].distant.are_known.sum() > 20
    before = aligned(room)
    view = view_of(room, LAST, before.T_wc)
    found = ScarceDepth(corners).resected(view, before)
    assert distance(before, room) > 0.03
    assert distance(found, room) < 0.01
    assert found.covariance is not None and expected_error(found.covariance)[0] < 0.015


def test_a_frame_that_is_sure_or_lost_stays(room: SyntheticRoom, corners: KeyframeCorners) -> None:
    for before in (aligned(room, off=(0.002, 0.0005)), aligned(room, status=Status.LOST)):
        assert ScarceDepth(corners).resected(view_of(room, LAST, before.T_wc), before) is before


def test_an_image_of_another_place_or_of_several_moments_moves_nothing(room: SyntheticRoom, corners: KeyframeCorners) -> None:
    before = aligned(room)
    assert ScarceDepth(corners).resected(view_of(room, 300, before.T_wc), before) is before
    view = view_of(room, LAST, before.T_wc)
    view.rectification = Rectification(RowTimes(0.02), np.zeros(6))
    assert ScarceDepth(corners).resected(view, before) is before


def test_corners_are_restored(corners: KeyframeCorners) -> None:
    other = KeyframeCorners(corners.graph, corners.features)
    other.restore(corners.state())
    assert np.array_equal(other.hosts[0].uv, corners.hosts[0].uv)
    for mine, its in zip(corners.hosts[0].depth(), other.hosts[0].depth()):
        assert np.array_equal(mine, its, equal_nan=True)
