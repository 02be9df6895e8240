"""Depth that is averaged where it may be, normals, and point-to-plane ICP in a corner of three walls and on a bare one."""

import math
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor

from idfslam.datasets import open_recording
from idfslam.geometry import se3
from idfslam.geometry.camera import Camera
from idfslam.sensing.depth_noise import difference_noise
from idfslam.tracking.correspondences import Correspondences
from idfslam.tracking.frame_features import FrameFeatures, averaged_depth, surface_normals
from idfslam.tracking.point_to_plane import plain_plane_system, plane_system, point_to_plane

CAMERA = Camera(80, 60, 70.0, 70.0, 39.5, 29.5)
T_KC = se3.exp(torch.tensor([0.03, -0.02, 0.04, 0.01, 0.02, -0.02], dtype=torch.float64))
CORNER = torch.tensor([[0.0, 0.0, -1.0, 2.0], [-0.8, 0.0, -0.6, 1.3], [0.0, -0.8, -0.6, 1.3]], dtype=torch.float64)  # walls n x = -d


def described(T_wc: Tensor, walls: Tensor = CORNER, noise: float = 0.0) -> FrameFeatures:
    """Walls (N, 4) seen from a pose: along each ray the first of them."""
    rays, normals = CAMERA.rays(CAMERA.pixels()).double() @ T_wc[:3, :3].T, walls[:, :3]
    along = (-walls[:, 3] - normals @ T_wc[:3, 3]) / (rays @ normals.T)
    depth = torch.where(along > 0, along, torch.inf).amin(-1).float()
    depth = depth + noise * torch.randn(depth.shape, generator=torch.Generator().manual_seed(0))
    return FrameFeatures(torch.zeros(1), torch.zeros(1), CAMERA.backproject(depth), CAMERA, CAMERA)


def no_matches() -> Correspondences:
    return Correspondences(torch.zeros(0, 2), torch.zeros(0, 2), torch.zeros(0, 3), torch.zeros(0, 3), torch.zeros(0))


def error(T: Tensor) -> tuple[float, float]:
    """[m], [degrees]."""
    delta = se3.inverse(T_KC) @ T
    return float(delta[:3, 3].norm()), math.degrees(float(se3.angle(delta)))


def test_depth_is_averaged_on_a_surface_and_not_across_edges() -> None:
    # 4 x 4 -> 2 x 2: means of 2.00, 2.01, 2.02, 2.03 and of the three readings of a block with a hole; a step from 1 to 3 m keeps its
    # centre reading, the lower right one; a block whose centre reading is missing takes the one above.
    depth = np.array([[2.00, 2.01, 2.0, 2.0], [2.02, 2.03, 0.0, 2.06], [1.0, 1.0, 0.0, 1.5], [1.0, 3.0, 0.0, 0.0]], np.float32)
    np.testing.assert_allclose(averaged_depth(depth, 2, 2), [[2.015, 2.02], [3.0, 1.5]], atol=1e-6)


def test_normals_of_a_slanted_wall() -> None:
    # The wall -0.28 x - 0.96 z = -2: its normal everywhere but on a border of 2 pixels, and none around a hole.
    wall = torch.tensor([[-0.28, 0.0, -0.96, 2.0]], dtype=torch.float64)
    points = described(torch.eye(4, dtype=torch.float64), wall).points
    points[20, 30] = 0
    normals = surface_normals(points)
    known = normals[..., 2] != 0
    assert int(known.sum()) == 56 * 76 - 5  # the hole itself and the four that reach for it
    torch.testing.assert_close(normals[known], wall[0, :3].float().expand(int(known.sum()), 3), atol=1e-4, rtol=0)


def test_three_walls_give_the_pose() -> None:
    # From the identity, 5.4 cm and 1.7 degrees off.
    frame, keyframe = described(T_KC), described(torch.eye(4, dtype=torch.float64))
    assert error(torch.eye(4, dtype=torch.float64))[0] == pytest.approx(0.054, abs=0.001)
    shift, turn = error(point_to_plane(torch.eye(4, dtype=torch.float64), frame, keyframe, no_matches(), steps=5))
    assert shift < 0.001
    assert turn < 0.03


@pytest.mark.parametrize("stride", [1, 4])
def test_compiled_equations_are_the_plain_ones(stride: int) -> None:
    frame, keyframe = described(T_KC, noise=0.002), described(torch.eye(4, dtype=torch.float64))
    start = T_KC @ se3.exp(torch.tensor([0.01, -0.01, 0.01, 0.005, 0, 0.01], dtype=torch.float64))
    H, b = plane_system(start, frame, keyframe, stride, 0.05)
    plain_H, plain_b = plain_plane_system(start, frame, keyframe, stride, 0.05)
    assert float(H.diagonal().min()) > 1e4
    torch.testing.assert_close(H, plain_H, rtol=1e-4, atol=1e-4 * float(H.abs().max()))
    torch.testing.assert_close(b, plain_b, rtol=1e-4, atol=1e-4 * float(b.abs().max()))


def test_matches_hold_where_a_wall_slides() -> None:
    # On one wall, straight ahead, depth knows nothing of x, y and the turn about z; 30 true matches do.
    wall = CORNER[:1]
    frame, keyframe = described(T_KC, wall, 0.002), described(torch.eye(4, dtype=torch.float64), wall)
    points = frame.points[5:55:10, 5:75:12].flatten(0, 1)
    matches = Correspondences(points[:, :2], points[:, :2], points, se3.transform(T_KC, points.double()).float(), torch.ones(len(points)))
    start = T_KC @ se3.exp(torch.tensor([0.01, -0.01, 0.01, 0, 0, 0.01], dtype=torch.float64))
    shift, turn = error(point_to_plane(start, frame, keyframe, matches, steps=5))
    assert shift < 0.003
    assert turn < 0.15


def test_nothing_to_hold_on_to_leaves_the_pose() -> None:
    nothing = FrameFeatures(torch.zeros(1), torch.zeros(1), torch.zeros(60, 80, 3), CAMERA, CAMERA)
    torch.testing.assert_close(point_to_plane(T_KC, nothing, nothing, no_matches(), steps=5), T_KC)


def test_noise_of_a_reading() -> None:
    # sigma(2 m) = 1.2 mm (1 + 1.5 * 1.6^2) = 5.81 mm, of a difference sqrt(2) times that: 8.21 mm.
    assert float(difference_noise(torch.tensor(2.0))) == pytest.approx(0.00821, abs=1e-5)


def test_it_makes_the_tracker_more_exact(box_recording: Path) -> None:
    from dataclasses import replace

    from idfslam.config import FinetuneConfig, TrackerConfig
    from idfslam.tracking.tracker import Tracker

    recording = open_recording(box_recording)
    truth: NDArray[np.float64] = np.linalg.inv(recording.ground_truth[0]) @ recording.ground_truth[4]  # type: ignore[index]
    shifts = []
    for steps in (0, 5):
        tracker = Tracker(replace(TrackerConfig(), plane_steps=steps), FinetuneConfig(enabled=False))
        result = tracker.track(tracker.extract_features(recording[4]), tracker.extract_features(recording[0]))
        shifts.append(float(np.linalg.norm((np.linalg.inv(truth) @ result.T_kc)[:3, 3])))
    assert shifts[1] < 0.002 < shifts[0]
