"""Depth kept for fusion: its size, its camera, means of readings of one surface, and what lies at edges and holes."""

import numpy as np

from helpers.painted_wall import CAMERA, at, painted
from idfslam.fusion.packed_depth import averaged, pack_depth
from idfslam.geometry.camera import Camera

LARGE = Camera(640, 480, 577.0, 577.0, 319.5, 239.5)


def test_a_plane_keeps_its_place_and_noise_is_halved() -> None:
    """Seen at a slant: inverse depth is linear in the image."""
    u, v = np.meshgrid(np.arange(640), np.arange(480))
    depth = (1 / (0.5 + 0.0002 * u + 0.0001 * v)).astype(np.float32)
    noise = np.random.default_rng(0).normal(0, 0.004, depth.shape).astype(np.float32)
    packed = pack_depth(depth + noise, LARGE).view(np.eye(4))
    assert packed.depth.shape == (240, 320) and packed.depth.dtype == np.float32
    c = packed.camera
    rays = [(np.arange(320) - c.cx) / c.fx * LARGE.fx + LARGE.cx, ((np.arange(240) - c.cy) / c.fy * LARGE.fy + LARGE.cy)[:, None]]
    off = packed.depth - 1 / (0.5 + 0.0002 * rays[0] + 0.0001 * rays[1])
    assert abs(off.mean()) < 1e-4
    np.testing.assert_allclose(off.std(), 0.002, rtol=0.05)


def test_no_reading_lies_in_mid_air_and_holes_stay() -> None:
    depth = np.full((480, 640), 1.0, np.float32)
    depth[:, 301:] = 2.0
    depth[:, 101] = 0
    small, _ = averaged(depth, LARGE, 2)
    assert set(np.unique(small)) == {0.0, 1.0, 2.0}
    assert (small[:, 50] == 0).all() and (small == 0).sum() == 240


def test_small_images_are_kept_as_they_are() -> None:
    T = at(0.0, 0.0, 0.2)
    depth = painted(0, T).depth.astype(np.float32)
    packed = pack_depth(depth, CAMERA)
    assert packed.camera == CAMERA and packed.counts.dtype == np.uint16
    np.testing.assert_allclose(packed.view(T).depth, depth, atol=depth.max() / 131_000)
    assert not pack_depth(np.zeros_like(depth), CAMERA).view(T).depth.any()
