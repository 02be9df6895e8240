"""Resection of images from known points: poses by hand, outliers, and what a pose before holds."""

import numpy as np
import torch
from torch import Tensor

from idfslam.adjustment.resection import resected
from idfslam.geometry import se3
from idfslam.geometry.camera import Camera
from idfslam.tracking.patch_alignment import AlignedPatches

CAMERA = Camera(320, 240, 280.0, 280.0, 159.5, 119.5)
TRUE = se3.exp(torch.tensor([0.3, -0.2, 0.1, 0.2, -0.4, 0.1], dtype=torch.float64))
BEFORE = se3.exp(torch.tensor([0.02, -0.01, 0.015, 0.005, -0.008, 0.004], dtype=torch.float64)) @ TRUE
LOOSE, TIGHT = 1e-2 * torch.eye(6, dtype=torch.float64), 1e-10 * torch.eye(6, dtype=torch.float64)


def shown(n: int, *, outliers: int = 0, nearest: float = 1.0, farthest: float = 6.0) -> AlignedPatches:
    """Random points of the world where an image at the true pose shows them, with a deviation of 0.1 px; some are shown 5 to 20 px off."""
    rng = np.random.default_rng(0)
    uv = torch.from_numpy(rng.uniform([10, 10], [310, 230], (n, 2)))
    points = se3.transform(TRUE, CAMERA.rays(uv) * torch.from_numpy(rng.uniform(nearest, farthest, (n, 1))))
    uv[:outliers] += torch.from_numpy(rng.uniform(5, 20, (outliers, 2)))
    nothing = torch.zeros(n, dtype=torch.float64)
    return AlignedPatches(points, uv, 100 * torch.eye(2, dtype=torch.float64).expand(n, 2, 2), nothing, nothing, CAMERA)


def off(T: Tensor) -> float:
    """Distance to the true pose [m + rad]."""
    change = se3.inverse(TRUE) @ T
    return float(change[:3, 3].norm() + se3.angle(change))


def test_exact_places_give_the_exact_pose() -> None:
    assert off(BEFORE) > 0.02
    assert off(resected(BEFORE, LOOSE, shown(40))) < 1e-4  # what is left is drawn to the pose before


def test_a_quarter_of_wrong_places_does_not_draw_it() -> None:
    assert off(resected(BEFORE, LOOSE, shown(80, outliers=20))) < 1e-3


def test_without_points_or_with_a_sure_pose_it_stays() -> None:
    assert off(resected(BEFORE, LOOSE, shown(0)) @ se3.inverse(BEFORE) @ TRUE) < 1e-12
    assert float((resected(BEFORE, TIGHT, shown(10)) - BEFORE).abs().max()) < 1e-4


def test_points_at_infinity_turn_it_and_leave_its_place() -> None:
    """The turn is found, and the centre moves by far less than it is off."""
    T = resected(BEFORE, 1e-4 * torch.eye(6, dtype=torch.float64), shown(60, nearest=900, farthest=1000))
    assert float(se3.angle(se3.inverse(TRUE) @ T)) < 2e-4 < float(se3.angle(se3.inverse(TRUE) @ BEFORE))
    assert float((T - BEFORE)[:3, 3].norm()) < 1e-4
