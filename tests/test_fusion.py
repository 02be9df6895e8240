"""The fusion of depth images: compiled and plain forms, a plane, what noise and views behind it change, and what is left out."""

import numpy as np
import pytest

from helpers.painted_wall import BOX, CAMERA, HALF, WALL, at, painted
from idfslam.fusion.constants import BLOCK
from idfslam.fusion.fuse import fuse, variance_factor
from idfslam.fusion.integration import Voxels, compiled_integrate, plain_integrate
from idfslam.fusion.prepared_depth import (
    compiled_inverse_depth_slopes,
    compiled_planes,
    plain_inverse_depth_slopes,
    plain_planes,
    prepared,
)
from idfslam.fusion.smoothing import around, compiled_sums_around, denoised, neighbours_of, plain_sums_around
from idfslam.fusion.tsdf_volume import STEPS, TsdfVolume
from idfslam.geometry.blocks import touched_blocks
from idfslam.geometry.depth_view import DepthView

VOXEL, TRUNCATION = 0.02, 0.08


def view(x: float, turn: float = 0.0, noise: float = 0.0, seed: int = 0) -> DepthView:
    T = at(x, 0.0, turn)
    depth = painted(0, T).depth + np.random.default_rng(seed).normal(0, noise, (CAMERA.height, CAMERA.width)) * (noise > 0)
    return DepthView(T, depth.astype(np.float32), CAMERA)


def facing(depth: float) -> DepthView:
    """A view of a wall, `depth` [m] before the camera."""
    return DepthView(np.eye(4), np.full((CAMERA.height, CAMERA.width), depth, np.float32), CAMERA)


def test_slopes_are_those_of_the_plain_form_and_of_a_plane() -> None:
    depth = view(0.1, 0.3, 0.002).depth
    depth[np.random.default_rng(1).random(depth.shape) < 0.1] = 0
    for found, expected in zip(compiled_inverse_depth_slopes(depth), plain_inverse_depth_slopes(depth)):
        np.testing.assert_allclose(found, expected, atol=1e-6)
    slopes = plain_inverse_depth_slopes(depth)
    for found, expected in zip(compiled_planes(depth, CAMERA, *slopes), plain_planes(depth, CAMERA, *slopes)):
        np.testing.assert_allclose(found, expected, rtol=1e-4)
    turn = 0.5
    rays = (np.arange(CAMERA.width) - CAMERA.cx) / CAMERA.fx
    plane = np.repeat(2 / (np.cos(turn) + np.sin(turn) * rays)[None], CAMERA.height, 0).astype(np.float32)
    slanted = prepared(DepthView(np.eye(4), plane, CAMERA))
    np.testing.assert_allclose(slanted.slope, 2 / plane, rtol=1e-3)  # the plane is 2 m from the camera


def test_information_falls_towards_an_edge_as_the_readings_of_the_surface_do() -> None:
    depth = np.full((CAMERA.height, CAMERA.width), 1.0, np.float32)
    depth[:, 80:] = 2.0
    along_row = prepared(DepthView(np.eye(4), depth, CAMERA)).information[60, 70:80]
    np.testing.assert_allclose(along_row[-3:] / along_row[0], [1, 4 / 5, 3 / 5], rtol=0.01)  # windows of five columns


def test_integration_is_that_of_the_plain_form() -> None:
    views = [view(-0.2, 0.1, 0.01), view(0.3, -0.4, 0.01, 1)]
    blocks = touched_blocks(views, BLOCK * VOXEL, TRUNCATION)
    blocks = blocks[np.random.default_rng(0).permutation(len(blocks))[:150]]
    found, expected = (Voxels.empty(VOXEL, TRUNCATION, blocks) for _ in range(2))
    for one in views:
        compiled_integrate(found, prepared(one))
        plain_integrate(expected, prepared(one))
    assert (found.weight > 0).mean() > 0.4 and found.scatter[:, 1].sum() > 1000
    same = (np.abs(found.distance - expected.distance) < 1e-5) & (
        np.abs(found.weight / expected.weight.max() - expected.weight / expected.weight.max()) < 1e-4
    )
    assert same.mean() > 0.999  # a voxel on the border of two pixels may get either
    np.testing.assert_allclose(found.scatter.sum(0), expected.scatter.sum(0), rtol=0.01)


def test_a_voxel_is_as_free_before_a_far_surface_as_before_a_near_one() -> None:
    """It has a tenth of the weight that a surface in it would have, and at most the reading's own."""
    information = {depth: prepared(facing(depth)).information[60, 80] for depth in (0.9, 1.0, 1.5, 4.0)}
    for depth, expected in ((1.0, 0.1 * information[0.9]), (1.5, 0.1 * information[0.9]), (4.0, information[4.0])):
        for integrated in (compiled_integrate, plain_integrate):
            voxels = Voxels.empty(0.01, 0.03, np.array([[0, 0, 11]]))
            integrated(voxels, prepared(facing(depth)))
            assert voxels.weight[0, 0, 0, 2] == pytest.approx(expected, rel=1e-3)  # 0.9 m before the camera


def fused_at(volume: TsdfVolume, points: np.ndarray) -> np.ndarray:
    """The fused distance [m], NaN where less than a tenth of it is trusted."""
    zero, one = (volume.blend(points.astype(np.float32), np.full(len(points), value, np.float32)) for value in (0, 1))
    trust = 1 - (one - zero)
    return np.where(trust > 0.1, zero / np.maximum(trust, 0.1), np.nan)


def test_the_surface_is_that_of_the_scene() -> None:
    volume = fuse([view(x, turn) for x, turn in ((-0.3, 0.2), (0.0, 0.0), (0.3, -0.2))], 0.01, 40_000)
    x, y = np.meshgrid(np.linspace(-0.15, 0.15, 20), np.linspace(-0.15, 0.15, 20))
    front = np.stack([x.ravel(), y.ravel(), np.full(x.size, BOX)], 1)
    wall = front + np.array([0.5, 0, WALL - BOX])
    for offset in (-0.01, 0.0, 0.01):
        for points in (front, wall):
            np.testing.assert_allclose(fused_at(volume, points + np.array([0, 0, offset])), -offset, atol=5e-4)
    before = fused_at(volume, front - np.array([0, 0, 0.04]))
    np.testing.assert_allclose(before[~np.isnan(before)], 0.03, atol=5e-4)  # free space: the truncation
    assert np.isnan(fused_at(volume, front + np.array([0, 0, 0.1]))).all()  # inside the box


def test_noise_is_averaged_and_far_readings_count_less() -> None:
    x, y = np.meshgrid(np.linspace(0.4, 0.6, 20), np.linspace(-0.2, 0.2, 20))
    wall = np.stack([x.ravel(), y.ravel(), np.full(x.size, WALL)], 1)
    spread = [np.nanstd(fused_at(fuse([view(0.01 * i, 0.0, 0.006, i) for i in range(count)], 0.01, 40_000), wall)) for count in (1, 16)]
    assert spread[1] < 0.4 * spread[0]
    far = view(0.5)
    near = DepthView(far.T_wc, far.depth / 2, CAMERA)
    assert prepared(far).information[60, 80] < prepared(near).information[60, 80] / 2


def test_what_has_no_depth_is_not_fused() -> None:
    """As what moves, whose depth is taken out."""
    hidden = view(0.0)
    hidden.depth[hidden.depth < WALL - 0.1] = 0
    volume = fuse([hidden], 0.01, 40_000)
    assert np.isnan(fused_at(volume, np.array([[0.0, 0.0, BOX]]))).all()
    assert not np.isnan(fused_at(volume, np.array([[HALF + 0.3, 0.0, WALL]]))).any()


def test_voxels_are_larger_where_blocks_would_be_too_many() -> None:
    views = [view(0.0)]
    many = fuse(views, 0.01, 40_000)
    few = fuse(views, 0.01, len(many.blocks) // 4)
    assert many.voxel == 0.01 and many.truncation == 0.03
    assert len(few.blocks) <= len(many.blocks) // 4 and few.voxel > 0.015 and few.truncation == pytest.approx(3 * few.voxel)


def test_readings_are_fused_into_the_blocks_of_the_views() -> None:
    one, both = fuse([view(0.0)], 0.01, 40_000), fuse([view(0.0)], 0.01, 40_000, readings=iter([view(0.0), view(0.2)]))
    assert np.array_equal(one.blocks, both.blocks) and both.trust.mean() > one.trust.mean()
    assert not fuse([view(0.0)], 0.01, 40_000, readings=iter([])).trust.any()


def test_trust_is_full_nowhere_and_zero_where_nothing_was_read() -> None:
    volume = fuse([view(0.0)], 0.01, 40_000)
    assert volume.trust.max() < 255 and (volume.trust == 0).any()
    assert np.abs(volume.distance).max() <= STEPS


def test_the_scatter_tells_how_noisy_the_readings_are() -> None:
    """Against the sensor's model, which expects 6 mm at 2 m: noise of that size, twice that, and none."""
    factors = []
    for noise in (0.0057, 0.0114, 0.0):
        voxels = Voxels.empty(0.02, 0.08, touched_blocks([view(0.0)], BLOCK * 0.02, 0.04))
        for i in range(12):
            compiled_integrate(voxels, prepared(view(0.01 * i, 0.0, noise, i)))
        factors.append(float(variance_factor(voxels)))
    assert 0.2 < factors[0] < 1.2  # readings are interpolated between four, which takes out some of it
    assert factors[1] > 2.5 * factors[0] and factors[2] < 0.02


def test_sums_are_those_of_the_plain_form_over_the_borders_of_blocks() -> None:
    random = np.random.default_rng(0)
    blocks = np.unique(random.integers(-3, 4, (120, 3)), axis=0)
    blocks = blocks[random.permutation(len(blocks))]
    rows, values = neighbours_of(blocks), random.normal(size=(len(blocks), BLOCK, BLOCK, BLOCK)).astype(np.float32)
    assert 0.2 < (rows >= 0).mean() < 0.5 and np.array_equal(rows[:, 1, 1, 1], np.arange(len(blocks)))
    np.testing.assert_array_equal(compiled_sums_around(rows, values), plain_sums_around(rows, values))
    one = np.zeros_like(values)
    one[0, 0, 0, 0] = 64
    sums = plain_sums_around(rows, one)
    assert sums[0, 0, 0, 0] == 8 and sums[0, 0, 0, 1] == 4 and sums[0, 0, 1, 1] == 2 and sums[0, 1, 1, 1] == 1
    for corner in np.ndindex(2, 2, 2):  # the blocks around the voxel in the corner, as far as there are some
        if (row := rows[(0, *(1 - np.array(corner)))]) >= 0:
            assert sums[(row, *(7 * np.array(corner)))] == 8 / 2 ** sum(corner)


def test_a_plane_is_left_as_it_is_by_smoothing_over_the_borders_of_blocks() -> None:
    blocks = np.array([(i, j, k) for i in range(2) for j in range(2) for k in range(2)], np.int64)
    place = blocks[:, None, None, None] * BLOCK + np.stack(np.meshgrid(*[np.arange(BLOCK)] * 3, indexing="ij"), -1)
    distance = (place @ np.array([0.01, -0.02, 0.03])).astype(np.float32)
    inner = ((place > 0) & (place < 2 * BLOCK - 1)).all(-1)
    smooth = around(blocks, distance, np.ones_like(distance, bool))
    np.testing.assert_allclose(smooth[inner], distance[inner], atol=1e-6)
    noisy = distance + np.random.default_rng(0).normal(0, 0.1, distance.shape).astype(np.float32)
    assert (around(blocks, noisy, np.ones_like(noisy, bool)) - distance)[inner].std() == pytest.approx(0.1 * (6 / 16) ** 1.5, rel=0.1)
    beyond = place[..., 0] >= BLOCK
    assert not around(blocks[:4], noisy[:4], np.zeros_like(noisy[:4], bool)).any()
    np.testing.assert_allclose(around(blocks, distance + ~beyond * 9, beyond)[inner & beyond].max(), distance.max(), atol=0.2)


def test_smoothing_leaves_an_edge_and_takes_noise_out_of_a_plane() -> None:
    """The distance to a right-angled edge, with 1 mm of noise in voxels of 1 cm."""
    blocks = np.array([(i, j, 0) for i in range(4) for j in range(4)], np.int64)
    place = blocks[:, None, None, None] * BLOCK + np.stack(np.meshgrid(*[np.arange(BLOCK)] * 3, indexing="ij"), -1)
    x, y = 0.01 * (place[..., 0] - 2 * BLOCK), 0.01 * (place[..., 1] - 2 * BLOCK)
    distance = np.maximum(x, y).astype(np.float32)
    noisy = distance + np.random.default_rng(0).normal(0, 0.001, distance.shape).astype(np.float32)
    seen, inner = np.ones_like(distance, bool), ((place > 0) & (place < np.array([4, 4, 1]) * BLOCK - 1)).all(-1)
    smooth = denoised(blocks, noisy, np.full_like(noisy, 1e-6), seen)
    edge, plane = inner & (np.abs(x - y) < 0.005), inner & (np.abs(x - y) > 0.025)
    blurred = np.abs(around(blocks, distance, seen) - distance)[edge].mean()
    assert blurred == pytest.approx(0.00375, rel=0.02)  # what a plain mean moves the edge by
    assert np.abs((smooth - distance)[edge].mean()) < 0.15 * blurred
    assert (smooth - distance)[plane].std() < 0.5 * 0.001
