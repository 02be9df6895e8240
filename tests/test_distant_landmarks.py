"""Landmarks beyond the sensor's reach: where they are found to lie, what has none, and what they hold."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from idfslam.adjustment.bundle_adjustment import Problem, adjust
from idfslam.adjustment.camera_model import NAMES, CameraModel
from idfslam.adjustment.distant_landmarks import distant_landmarks
from idfslam.adjustment.landmark_tracks import KeyframeView, features_of, find_tracks
from idfslam.adjustment.observations import Array, Observations, together
from idfslam.adjustment.residuals import camera_points
from idfslam.datasets.generated.room import SyntheticRoom
from idfslam.frame import Frame

FRAMES = range(0, 90, 10)
REACH = 2.8  # [m] of the sensor: beyond it the frames have no depth


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    """Frames of a generated room, with all of its depth."""
    room = SyntheticRoom(seed=3, frames=600, width=320, height=240, noise=False)
    return [room[i] for i in FRAMES]


@pytest.fixture(scope="module")
def true() -> np.ndarray:
    """(K, 4, 4) true poses, in the frame of the first."""
    poses = np.asarray(SyntheticRoom(seed=3, frames=600, width=320, height=240, noise=False).ground_truth)[list(FRAMES)]
    return np.linalg.inv(poses[0]) @ poses


def views_of(frames: list[Frame]) -> list[KeyframeView]:
    """The views of a sensor of short reach."""
    return [KeyframeView.of(replace(frame, depth=np.where(frame.depth < REACH, frame.depth, 0).astype(np.float32))) for frame in frames]


def found_in(views: list[KeyframeView], poses: np.ndarray) -> tuple[Array, Observations]:
    """The distant landmarks of views at poses T_wk (K, 4, 4)."""
    model = CameraModel.as_stated(views[0].camera)
    return distant_landmarks(views, [features_of(view, model) for view in views], poses, model)


def test_landmarks_lie_on_the_surface_that_the_sensor_does_not_reach(frames: list[Frame], true: np.ndarray) -> None:
    points, seen = found_in(views_of(frames), true)
    assert len(points) > 150
    host = seen[seen.distant]
    z = camera_points(true, points, host)[:, 2]
    u, v = np.rint(host.uv).astype(int).T
    depth = np.array([frames[k].depth[b, a] for k, a, b in zip(host.keyframe, u, v)])
    assert np.median(np.abs(z / depth - 1)) < 0.02
    assert np.mean(np.abs(z / depth - 1) < 0.1) > 0.8


def test_what_moves_and_black_borders_have_none(frames: list[Frame], true: np.ndarray) -> None:
    views = views_of(frames)
    left = np.zeros(views[0].grey.shape, bool)
    left[:, :160] = True
    hidden = [replace(view, moving=left, depth=np.where(left, 0, view.depth).astype(np.float32)) for view in views]
    black = [replace(view, grey=np.where(left, 0, view.grey).astype(np.uint8)) for view in views]
    for some in (hidden, black):
        seen = found_in(some, true)[1]
        assert len(seen) > 500
        assert seen.uv[:, 0].min() > 159


def test_a_sensor_that_reaches_everything_has_none(frames: list[Frame], true: np.ndarray) -> None:
    views = [KeyframeView.of(frame) for frame in frames]
    assert (views[0].depth > 0).all()
    assert len(found_in(views, true)[0]) == 0


def test_they_hold_what_scarce_depth_does_not(frames: list[Frame], true: np.ndarray) -> None:
    views, rng = views_of(frames), np.random.default_rng(0)
    model, poses = CameraModel.as_stated(views[0].camera), true.copy()
    for T in poses[1:]:
        T[:3, 3] += 0.005 * rng.standard_normal(3)
        T[:3, :3] = T[:3, :3] @ Rotation.from_rotvec(0.002 * rng.standard_normal(3)).as_matrix()
    fixed = np.arange(len(poses)) == 0
    near = find_tracks(views, [features_of(view, model) for view in views], poses, model, coarse=False)
    both = together([near, found_in(views, poses)])
    off = []
    for points, sightings in (near, both):
        adjusted = adjust(Problem(model, poses, points, sightings, fixed, np.zeros(len(NAMES), bool)))
        off.append(np.linalg.norm(adjusted.problem.poses[:, :3, 3] - true[:, :3, 3], axis=1).mean())
    assert off[0] > 0.05  # the first keyframe has depth on a tenth of its image, and hardly any landmark with depth
    assert off[1] < 0.003  # 1.9 mm here
