"""The generated corridor: a closed circuit, doors that look alike, exact depth; a walk that closes its loop and never repeats itself."""

from functools import cache

import cv2
import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from idfslam.datasets.generated.corridor import SyntheticCorridor
from idfslam.datasets.generated.corridor_walk import closed_path, lap_frames, walk
from idfslam.datasets.generated.rendered import RenderedRecording
from idfslam.errors import ConfigError, FrameError
from idfslam.geometry.camera import Camera
from idfslam.scenes.corridor import DOOR_SPACING, HEIGHT, Building, draw_corridor
from idfslam.scenes.furniture import place, tilt
from idfslam.scenes.ray_casting import build_hierarchy, cast

SEEDS = range(6)


@cache
def dark(seed: int) -> Building:
    return draw_corridor(seed)


@cache
def one_lap(seed: int) -> NDArray[np.float64]:
    plan = dark(seed).plan
    return walk(seed, lap_frames(plan.half, 1), plan)


@pytest.fixture(scope="module")
def recording() -> SyntheticCorridor:
    return SyntheticCorridor(0, laps=2)


# ----- the building


@pytest.mark.parametrize("seed", SEEDS)
def test_size(seed: int) -> None:
    plan = dark(seed).plan
    assert 25 < 4 * sum(plan.half) < 32
    assert 1.6 < plan.width < 2.2
    assert len(plan.openings) == 4


@pytest.mark.parametrize("seed", SEEDS)
def test_doors_stand_at_regular_distances_on_all_sides(seed: int) -> None:
    """On the outer walls at -3.6, -1.2, 1.2, 3.6 m of the long sides, -2.4, 0, 2.4 m of the short ones; an opening takes one place each."""
    plan = dark(seed).plan
    assert len(plan.doors) == 10 + 6  # outer walls, block
    assert DOOR_SPACING == 2.4
    for k in range(4):
        T, _ = plan.outer(k)
        on_wall = [np.linalg.inv(T) @ D for D in plan.doors]
        x = sorted(D[0, 3] for D in on_wall if abs(D[1, 3]) < 1e-9 and np.allclose(D[:3, :3], np.eye(3)))
        opening = (np.linalg.inv(T) @ plan.openings[k])[0, 3]
        expected = (-2.4, 0, 2.4) if k % 2 else (-3.6, -1.2, 1.2, 3.6)
        np.testing.assert_allclose(sorted([*x, opening]), expected, atol=1e-9)


def test_doors_look_alike_and_walls_do_not(recording: SyntheticCorridor) -> None:
    """Seen from the front at 1.1 m, doors of all sides have one texture; the plaster beside them differs from door to door."""
    camera = Camera(160, 120, 110, 110, 79.5, 59.5)
    panels, walls, depths = [], [], []
    for D in recording.corridor.plan.doors:
        view = recording.render(D @ place(0, 1.1, 1.4, turn=180) @ tilt(0, -90), camera)
        panels.append(detail(view.colour[10:50, 45:115]))
        walls.append(detail(view.colour[10:50, 136:158]))
        depths.append(view.depth[10:50, 45:115])
    alike, unlike = np.corrcoef(panels), np.corrcoef(walls)
    others = ~np.eye(len(panels), dtype=bool)
    assert alike[others].min() > 0.9
    assert np.median(unlike[others]) < 0.5
    np.testing.assert_allclose(depths, np.broadcast_to(depths[0], np.shape(depths)), atol=1e-6)
    assert depths[0].min() == pytest.approx(1.1 - 0.032, abs=1e-6)  # the panels


def detail(colour: NDArray[np.float32]) -> NDArray[np.float32]:
    """What is left of the image without the slow changes of light."""
    grey = colour.mean(2)
    return (grey - cv2.GaussianBlur(grey, (0, 0), 4)).ravel()


@pytest.mark.parametrize("seed", SEEDS)
def test_walls_are_closed_and_the_camera_stays_clear(seed: int) -> None:
    """Rays to all sides from the walk end within the length of the corridor, and none ends within 0.5 m."""
    shapes = np.array(dark(seed).scene.shapes)
    nodes, rng = build_hierarchy(shapes), np.random.default_rng(0)
    directions = rng.standard_normal((300, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    for T in one_lap(seed)[::25]:
        lengths = [cast(shapes, nodes, *T[:3, 3], *d, 1e3, -1)[0] for d in directions]
        assert min(lengths) > 0.5
        assert max(lengths) < 13


# ----- the walk


@pytest.mark.parametrize("seed", SEEDS)
def test_a_lap_ends_where_it_began_and_goes_on_for_two_metres_and_a_half(seed: int) -> None:
    poses, path = one_lap(seed), closed_path(dark(seed).plan.half)
    np.testing.assert_array_equal(path.points[0], path.points[-1])
    assert 1200 < len(poses) < 1800
    position = poses[:, :3, 3]
    away = np.linalg.norm(position - position[0], axis=1)
    back = 600 + int(away[600:].argmin())
    assert away[back] < 0.25
    assert away.max() > 6
    walked = np.linalg.norm(np.diff(position[back:], axis=0), axis=1).sum()
    assert walked == pytest.approx(2.5, abs=0.25)
    beginning = position[:200]
    nearest = [np.linalg.norm(beginning - p, axis=1).min() for p in position[back:]]
    assert max(nearest) < 0.35


@pytest.mark.parametrize("seed", SEEDS)
def test_motion_is_a_persons(seed: int) -> None:
    poses = one_lap(seed)
    R = poses[:, :3, :3]
    np.testing.assert_allclose(R @ R.transpose(0, 2, 1), np.tile(np.eye(3), (len(R), 1, 1)), atol=1e-12)
    speed = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1) * 30
    angle = np.rad2deg(np.arccos(np.clip((np.trace(R[:-1].transpose(0, 2, 1) @ R[1:], axis1=1, axis2=2) - 1) / 2, -1, 1)))
    assert 0.45 < speed.min() < speed.max() < 0.85
    assert 0.6 < speed.mean() < 0.7
    assert 0.4 < angle.mean() < 1.1
    assert angle.max() < 3


def test_laps_differ_and_a_longer_walk_begins_like_a_shorter_one() -> None:
    plan = dark(1).plan
    poses = walk(1, 10_000, plan)
    np.testing.assert_array_equal(poses[:700], walk(1, 700, plan))
    lap = round(closed_path(plan.half).time[-1] * 30)
    assert len(poses) > 7 * lap
    again = [np.linalg.norm(poses[i + 2 * lap - 30 : i + 2 * lap + 30, :3, 3] - poses[i, :3, 3], axis=1).min() for i in range(100, lap, 50)]
    assert 0.02 < np.mean(again) < 0.25  # the same corridor, another way through it
    forward = poses[:, :3, 2]
    assert np.mean((forward[:lap] * forward[2 * lap : 3 * lap]).sum(1) < np.cos(np.deg2rad(10))) > 0.3


# ----- images


def test_surface_agrees_with_depth_and_normals(recording: SyntheticCorridor) -> None:
    """Rays through pixels meet the mesh where the depth image says, to 2 mm, and on the front of its triangles."""
    surface, camera = recording.surface(), recording.camera
    rng = np.random.default_rng(0)
    for index in range(0, 1400, 140):
        T = recording.ground_truth[index]
        view = recording.render(T)
        assert view.depth.min() > 0.4
        assert view.depth.max() < 12
        v, u = rng.integers(0, 240, 400), rng.integers(0, 320, 400)
        rays = camera.rays(torch.from_numpy(np.stack([u, v], 1)).double()).numpy() @ T[:3, :3].T
        points, ray, triangle = surface.ray.intersects_location(np.tile(T[:3, 3], (400, 1)), rays, multiple_hits=False)
        agrees = np.abs((points - T[:3, 3]) @ T[:3, 2] - view.depth[v, u][ray]) < 0.002
        front = (surface.face_normals[triangle] * (view.normals[v, u][ray] @ T[:3, :3].T)).sum(1) > 0.9
        assert len(ray) == 400
        assert agrees.mean() > 0.99
        assert (front | ~agrees).mean() > 0.99
    assert surface.bounds[1, 2] == pytest.approx(HEIGHT + 0.1)  # walls reach through the ceiling


def test_most_frames_have_features_and_some_hardly_any(recording: SyntheticCorridor) -> None:
    detector, counts = cv2.ORB_create(500), []
    for index in range(0, 1300, 52):
        colour = recording[index].colour
        assert np.isfinite(colour).all()
        assert 0.2 < colour.mean() < 0.8
        counts.append(len(detector.detect(cv2.cvtColor((colour * 255).astype(np.uint8), cv2.COLOR_RGB2GRAY))))
    assert np.median(counts) > 200
    assert np.mean(np.array(counts) > 50) > 0.8
    assert min(counts) < 120


def test_frames_repeat_and_noise_leaves_holes(recording: SyntheticCorridor) -> None:
    frame = recording[450]
    np.testing.assert_array_equal(frame.colour, recording[450].colour)
    assert (frame.index, frame.timestamp, frame.depth.shape) == (450, 15.0, (240, 320))
    assert (frame.depth > 0).all()
    sensor = RenderedRecording("noisy", recording.corridor, recording.ground_truth, (320, 240), seed=0, noise=True)
    noisy = sensor[450]
    np.testing.assert_array_equal(noisy.depth, sensor[450].depth)
    assert 0.5 < (noisy.depth > 0).mean() < 1
    assert noisy.depth.max() < 4.7


def test_names_and_lengths(recording: SyntheticCorridor) -> None:
    assert recording.name == "corridor-0-2laps"
    plan = recording.corridor.plan
    lap = lap_frames(plan.half, 2) - lap_frames(plan.half, 1)
    assert len(recording) == lap_frames(plan.half, 1) + lap
    with pytest.raises(FrameError, match=f"it has 0 to {len(recording) - 1}"):
        recording[len(recording)]
    with pytest.raises(ConfigError, match="0 laps"):
        SyntheticCorridor(laps=0)
