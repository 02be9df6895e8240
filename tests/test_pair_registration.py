"""A view is registered with a keyframe by features, or by patches alone where its pose is roughly known; features are extracted beside."""

import threading

import numpy as np
import pytest
import torch
from torch import Tensor

from idfslam.config import FinetuneConfig, TrackerConfig
from idfslam.datasets.generated.room import SyntheticRoom
from idfslam.frame import Frame
from idfslam.geometry import se3
from idfslam.graph.keyframe import Keyframe
from idfslam.slam.front_end.pair_registration import PairRegistration
from idfslam.slam.front_end.registered_pose import RegisteredPose
from idfslam.slam.keyframe_features import KeyframeFeatures
from idfslam.tracking.frame_features import FrameFeatures
from idfslam.tracking.tracker import Tracker

EYE = torch.eye(4, dtype=torch.float64)
SECOND = 20  # the frame that is registered with the first


class CountingTracker(Tracker):
    """A tracker that notes by which thread features are extracted."""

    threads: list[str]

    def extract_features(self, frame: Frame | FrameFeatures) -> FrameFeatures:
        self.threads.append(threading.current_thread().name)
        return super().extract_features(frame)


@pytest.fixture
def tracker() -> CountingTracker:
    made = CountingTracker(TrackerConfig(), FinetuneConfig(enabled=False))
    made.threads = []
    return made


@pytest.fixture(scope="module")
def room() -> SyntheticRoom:
    return SyntheticRoom(seed=3, frames=600, width=320, height=240, noise=False)


@pytest.fixture(scope="module")
def T_wc(room: SyntheticRoom) -> Tensor:
    """The second frame's pose (4, 4) in the first."""
    return torch.from_numpy(np.linalg.inv(room.ground_truth[0]) @ np.asarray(room.ground_truth[SECOND]))


def view(room: SyntheticRoom, i: int, T_wc: Tensor = EYE) -> Keyframe:
    frame: Frame = room[i]
    return Keyframe(frame, T_wc, torch.from_numpy(frame.depth), torch.from_numpy(frame.colour))


def off_by(degrees: float) -> Tensor:
    return se3.exp(torch.tensor([0.0, 0.0, 0.0, 0.0, np.radians(degrees), 0.0], dtype=torch.float64))


def error(found: RegisteredPose | None, T_wc: Tensor) -> float:
    """[m]"""
    assert found is not None
    return float((found.T_wc - T_wc)[:3, 3].norm())


def test_near_its_pose_a_view_is_registered_without_features(room: SyntheticRoom, T_wc: Tensor, tracker: CountingTracker) -> None:
    pairs = PairRegistration(tracker, KeyframeFeatures(tracker))
    found = pairs.register(view(room, SECOND), view(room, 0), near=T_wc @ off_by(0.7))
    assert error(found, T_wc) < 0.003
    assert tracker.threads == []
    assert found is not None and found.result.convinces


@pytest.mark.parametrize("degrees", [None, 15])
def test_without_a_pose_or_far_from_it_features_decide(
    room: SyntheticRoom, T_wc: Tensor, tracker: CountingTracker, degrees: float | None
) -> None:
    pairs = PairRegistration(tracker, KeyframeFeatures(tracker))
    found = pairs.register(view(room, SECOND), view(room, 0), near=None if degrees is None else T_wc @ off_by(degrees))
    assert error(found, T_wc) < 0.003
    assert len(tracker.threads) == 2


def test_while_something_moves_features_decide(room: SyntheticRoom, T_wc: Tensor, tracker: CountingTracker) -> None:
    pairs, shown = PairRegistration(tracker, KeyframeFeatures(tracker)), view(room, SECOND)
    shown.hide(np.eye(240, 320, dtype=np.bool_))
    found = pairs.register(shown, view(room, 0), near=T_wc)
    assert error(found, T_wc) < 0.003
    assert len(tracker.threads) == 2


def test_features_are_extracted_once_beside_and_are_the_same(room: SyntheticRoom, tracker: CountingTracker) -> None:
    features, keyframe = KeyframeFeatures(tracker), view(room, 0)
    features.extract_beside(keyframe)
    found = features.of(keyframe)
    assert len(tracker.threads) == 1
    assert tracker.threads[0].startswith("features")
    assert features.of(keyframe) is found
    assert torch.equal(found.trunk, tracker.extract_features(room[0]).trunk)


def test_those_of_the_keyframe_before_are_kept_though_nobody_asked(room: SyntheticRoom, tracker: CountingTracker) -> None:
    features, keyframe = KeyframeFeatures(tracker), view(room, 0)
    features.extract_beside(keyframe)
    features.extract_beside(view(room, SECOND))
    assert isinstance(keyframe.features, FrameFeatures)
    assert not keyframe.features.are_images_alone


def test_what_is_known_is_not_extracted_again(room: SyntheticRoom, tracker: CountingTracker) -> None:
    features, keyframe = KeyframeFeatures(tracker), view(room, 0)
    found = features.of(keyframe)
    features.extract_beside(keyframe)
    assert features.of(keyframe) is found
    assert len(tracker.threads) == 1
