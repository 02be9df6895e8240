"""Landmarks that are found while a recording runs: in generated images at true poses they are where their hosts saw them."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch

from idfslam.adjustment.camera_model import CameraModel
from idfslam.adjustment.growing_tracks import GrowingTracks
from idfslam.adjustment.landmark_tracks import KeyframeView
from idfslam.adjustment.observations import Array, Observations
from idfslam.adjustment.residuals import residuals
from idfslam.datasets.generated.room import SyntheticRoom
from idfslam.frame import Frame
from idfslam.tracking.frame_features import FrameFeatures, averaged_depth, brightness

FRAMES = range(0, 60, 15)


def features_of(frame: Frame) -> FrameFeatures:
    """Images without features of the network."""
    camera = frame.camera.resized(160, 120)
    points = camera.backproject(torch.from_numpy(averaged_depth(frame.depth, 120, 160)))
    return FrameFeatures(torch.zeros(0, 0, 0), torch.zeros(3, 120, 160), points, camera, frame.camera, torch.from_numpy(brightness(frame)))


@pytest.fixture(scope="module")
def room() -> SyntheticRoom:
    return SyntheticRoom(seed=0, frames=600, width=320, height=240)


@pytest.fixture(scope="module")
def poses(room: SyntheticRoom) -> Array:
    return np.asarray(room.ground_truth)[list(FRAMES)]


@pytest.fixture
def tracks(room: SyntheticRoom, poses: Array) -> GrowingTracks:
    made, shown = GrowingTracks(), list[FrameFeatures]()
    for k, index in enumerate(FRAMES):
        frame = room[index]
        shown.append(features_of(frame))
        others = [(j, shown[j], np.linalg.inv(poses[j]) @ poses[k]) for j in range(k)]
        made.add(k, shown[k], KeyframeView.of(frame), others, CameraModel.as_stated(frame.camera))
    return made


def everything(tracks: GrowingTracks, poses: Array) -> tuple[Array, Observations]:
    return tracks.seen_by(np.ones(len(poses), bool), poses)


def test_landmarks_lie_where_they_are_seen(tracks: GrowingTracks, room: SyntheticRoom, poses: Array) -> None:
    points, seen = everything(tracks, poses)
    assert len(points) > 150
    off = residuals(CameraModel.as_stated(room.camera), poses, points, seen)
    pixels = np.linalg.solve(seen.root, off[:, :2, None])[:, :, 0]
    assert np.median(np.linalg.norm(pixels, axis=1)) < 0.15  # 0.08 px here
    assert (np.bincount(seen.landmark) >= 2).all()
    assert np.unique(np.stack([seen.landmark, seen.keyframe]), axis=1).shape[1] == len(seen)


def test_a_window_has_what_its_keyframes_see(tracks: GrowingTracks, poses: Array) -> None:
    points, seen = tracks.seen_by(np.array([False, False, False, True]), poses)
    assert 0 < len(points) <= len(everything(tracks, poses)[0])
    assert set(seen.landmark) == set(seen.landmark[seen.keyframe == 3])


def test_what_moves_is_forgotten_and_the_rest_stays(tracks: GrowingTracks, room: SyntheticRoom, poses: Array) -> None:
    points, before = everything(tracks, poses)
    moving = np.zeros((240, 320), bool)
    moving[:, :160] = True
    tracks.hide(1, moving)
    after_points, after = everything(tracks, poses)
    assert not (after.uv[after.keyframe == 1, 0] < 159.5).any()
    right = before.uv[(before.keyframe == 1) & (before.uv[:, 0] > 159.5)]
    assert len(right) > 20
    assert {tuple(uv) for uv in after.uv[after.keyframe == 1]} >= {tuple(uv) for uv in right}
    assert {tuple(p) for p in after_points} <= {tuple(p) for p in points}
    off = residuals(CameraModel.as_stated(room.camera), poses, after_points, after)
    pixels = np.linalg.solve(after.root, off[:, :2, None])[:, :, 0]
    assert np.median(np.linalg.norm(pixels, axis=1)) < 0.15  # each is still paired with its own point


@pytest.mark.parametrize("forget", [lambda tracks: tracks.forget(1), lambda tracks: tracks.separate([0, 1, 0, 0])])
def test_what_is_forgotten_is_seen_no_more(tracks: GrowingTracks, poses: Array, forget: Callable[[GrowingTracks], None]) -> None:
    before = everything(tracks, poses)[1]
    assert (before.keyframe == 1).any()
    forget(tracks)
    after = everything(tracks, poses)[1]
    assert not (after.keyframe == 1).any()
    assert len(after) > 0.3 * len(before)


def test_a_state_restores_it(tracks: GrowingTracks, poses: Array) -> None:
    other = GrowingTracks()
    other.restore(tracks.state())
    for one, same in zip(vars(everything(tracks, poses)[1]).values(), vars(everything(other, poses)[1]).values()):
        np.testing.assert_array_equal(one, same)


def test_corners_without_depth_are_landmarks_once_two_others_see_them(room: SyntheticRoom, poses: Array) -> None:
    """A sensor that reaches 2 m: the landmarks beyond lie where the whole depth image has them."""
    made, shown, model = GrowingTracks(), list[FrameFeatures](), CameraModel.as_stated(room.camera)
    for k, index in enumerate(FRAMES):
        frame = room[index]
        frame = replace(frame, depth=np.where(frame.depth < 2.0, frame.depth, 0).astype(np.float32))
        shown.append(features_of(frame))
        others = [(j, shown[j], np.linalg.inv(poses[j]) @ poses[k]) for j in range(k)]
        made.add(k, shown[k], KeyframeView.of(frame), others, model)
        assert k >= 2 or not everything(made, poses[: k + 1])[1].distant.any()
    points, seen = everything(made, poses)
    distant = np.unique(seen.landmark[seen.distant])
    assert len(distant) > 20
    assert (np.bincount(seen.landmark)[distant] >= 3).all()
    first = seen[seen.distant & (seen.keyframe == 0)]
    z = np.einsum("j,nj->n", poses[0][:3, 2], points[first.landmark] - poses[0][:3, 3])
    u, v = np.rint(first.uv).astype(int).T
    assert np.median(np.abs(z / room[0].depth[v, u] - 1)) < 0.05


def test_corners_without_depth_are_restored(room: SyntheticRoom, poses: Array) -> None:
    frame = replace(room[0], depth=np.zeros_like(room[0].depth))
    made, other = GrowingTracks(), GrowingTracks()
    made.add(0, features_of(frame), KeyframeView.of(frame), [], CameraModel.as_stated(frame.camera))
    other.restore(made.state())
    assert np.array_equal(other._hosted[0].points, made._hosted[0].points)
    assert len(other._hosted[0]) > 50
