"""Joint resection of images from known points: poses by hand, outliers, points of uncertain place, and what the poses before hold."""

import numpy as np

from idfslam.adjustment.bundle_adjustment import exp
from idfslam.adjustment.camera_model import CameraModel
from idfslam.adjustment.joint_resection import Images, jointly_resected, on_rays
from idfslam.adjustment.observations import Array, Observations
from idfslam.geometry.camera import Camera

MODEL = CameraModel.as_stated(Camera(320, 240, 280.0, 280.0, 159.5, 119.5))
TRUE = exp(np.array([[0.3, -0.2, 0.1, 0.2, -0.4, 0.1], [0.42, -0.18, 0.1, 0.2, -0.4, 0.1], [0.36, -0.08, 0.12, 0.2, -0.4, 0.1]]))
BEFORE = TRUE @ exp(np.array([[2, -1, 1.5, 0.5, -0.8, 0.4], [-1, 2, 1, -0.4, 0.6, 0.5], [1.5, 1, -2, 0.8, 0.3, -0.5]]) / 100)
LOOSE, TIGHT = 1e-2 * np.eye(6), 1e-10 * np.eye(6)


def shown(
    n: int,
    covariance: Array = LOOSE,
    *,
    outliers: int = 0,
    nearest: float = 1.0,
    farthest: float = 6.0,
    wrong: float = 0.0,
    sigma: float = 0.0,
) -> Images:
    """Random points that three images show with a deviation of 0.1 px, and some of them 5 to 20 px off.

    wrong: by how much three quarters of the points are read too far away, as a share of their distance; sigma: what is stated of it.
    """
    rng = np.random.default_rng(0)
    uv, z = rng.uniform([40, 40], [280, 200], (n, 2)), rng.uniform(nearest, farthest, n)
    points = MODEL.rays(uv) * z[:, None] @ TRUE[0, :3, :3].T + TRUE[0, :3, 3]
    places = np.stack([MODEL.project((points - T[:3, 3]) @ T[:3, :3])[0] for T in TRUE], 1).reshape(3 * n, 2)
    places[: 3 * outliers] += rng.uniform(5, 20, (3 * outliers, 2))
    image, landmark = np.tile(np.arange(3), n), np.repeat(np.arange(n), 3)
    root, nothing = np.tile(10 * np.eye(2), (3 * n, 1, 1)), np.zeros(3 * n)
    seen = Observations(image, landmark, places, root, nothing, np.ones(3 * n), np.zeros((3 * n, 2)))
    most = np.arange(n) % 4 > 0
    read, covariances = on_rays(MODEL, uv, z * (1 + wrong * most), np.tile(1e-4 * np.eye(2), (n, 1, 1)), sigma * z * most)
    R = TRUE[0, :3, :3]
    return Images(MODEL, BEFORE, np.tile(covariance, (3, 1, 1)), read @ R.T + TRUE[0, :3, 3], R @ covariances @ R.T, seen)


def off(poses: Array) -> float:
    """Largest distance to a true pose [m + rad]."""
    change = np.linalg.inv(TRUE) @ poses
    turn = np.arccos(((np.trace(change, axis1=1, axis2=2) - 1) / 2).clip(-1, 1))
    return float((np.linalg.norm(change[:, :3, 3], axis=1) + turn).max())


def test_exact_places_give_the_exact_poses() -> None:
    assert off(BEFORE) > 0.02
    assert off(jointly_resected([shown(40)])[0]) < 1e-4  # what is left is drawn to the poses before


def test_a_quarter_of_wrong_places_does_not_draw_them() -> None:
    assert off(jointly_resected([shown(80, outliers=20)])[0]) < 1e-3


def test_without_points_or_with_sure_poses_they_stay() -> None:
    assert np.allclose(jointly_resected([shown(0)])[0], BEFORE, atol=1e-12)
    assert np.allclose(jointly_resected([shown(3, TIGHT)])[0], BEFORE, atol=1e-4)


def test_points_at_infinity_turn_them_and_leave_their_places() -> None:
    """The turn is found, and the centres move by far less than they are off."""
    poses = jointly_resected([shown(60, 1e-4 * np.eye(6), nearest=900, farthest=1000)])[0]
    assert np.abs(poses[:, :3, :3] - TRUE[:, :3, :3]).max() < 2e-4 < np.abs(BEFORE - TRUE)[:, :3, :3].max()
    assert np.abs(poses - BEFORE)[:, :3, 3].max() < 1e-4


def test_points_read_wrongly_do_not_draw_the_poses() -> None:
    """Thirty of forty are read 3 % too far. Where that is told, the other ten place the poses."""
    told, untold = (jointly_resected([shown(40, wrong=0.03, sigma=sigma)])[0] for sigma in (0.03, 0.0))
    assert off(told) < 0.001 < 0.003 < off(untold)


def test_poses_before_count_by_how_far_the_points_move_them() -> None:
    """Covariances that are stated 25 times too small hold the poses little: they would stay 0.022 off."""
    assert off(jointly_resected([shown(12, np.diag([1.6e-5] * 3 + [4e-6] * 3))])[0]) < 0.001
