"""Resection of images from known points: poses by hand, outliers, and what a pose before holds."""

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from idfslam.adjustment.resection import resected, with_spread
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


def test_a_spread_of_points_takes_what_lies_along_it() -> None:
    """The information of places is the inverse of their own covariance and of what the spread moves them by, together."""
    seen = shown(30)
    spread = torch.from_numpy(np.random.default_rng(1).normal(0, 0.05, (30, 3)))
    places = [CAMERA.project(se3.transform(se3.inverse(TRUE), seen.points + sign * 1e-4 * spread))[0] for sign in (1, -1)]
    moved = (places[0] - places[1]) / 2e-4
    expected = torch.linalg.inv(torch.linalg.inv(seen.information) + moved[:, :, None] * moved[:, None])
    assert torch.allclose(with_spread(seen, TRUE, spread).information, expected, rtol=1e-4, atol=1e-6)
    assert torch.equal(with_spread(seen, TRUE, torch.zeros(30, 3).double()).information, seen.information)


def test_points_of_unknown_distance_tell_what_lies_across_their_rays() -> None:
    """Points whose inverse distance to a host 20 cm beside is up to 30 % wrong. As exact ones they would draw the pose away."""
    seen, rng = shown(60, nearest=2.0), np.random.default_rng(2)
    host = TRUE[:3, 3] + torch.tensor([0.2, 0.0, 0.0], dtype=torch.float64)
    believed = host + (seen.points - host) / (1 + torch.from_numpy(rng.uniform(-0.3, 0.3, (60, 1))))
    wrong, spread = replace(seen, points=believed), 0.3 / 3**0.5 * (believed - host)
    found = resected(BEFORE, LOOSE, with_spread(wrong, BEFORE, spread))
    assert off(found) < 0.5 * off(resected(BEFORE, LOOSE, wrong)), (off(found), off(resected(BEFORE, LOOSE, wrong)))
