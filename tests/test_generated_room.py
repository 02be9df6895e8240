"""The synthetic room: its geometry against hand-worked distances and its own surface, its light, its tour, its noise."""

from functools import cache

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from idfslam.datasets.generated.room import BARE_PASSAGE, TOUR, SyntheticRoom, tour
from idfslam.datasets.generated.sensor_noise import axial_sigma, noisy_colour, noisy_depth, quantise
from idfslam.errors import ConfigError, FrameError
from idfslam.geometry.camera import Camera
from idfslam.scenes import ray_casting
from idfslam.scenes.furniture import SceneBuilder, place, tilt
from idfslam.scenes.ray_casting import BOX, ELLIPSOID, FRUSTUM, build_hierarchy, cast, chart_size, hit_shape, point_on, prune, surface_at
from idfslam.scenes.room import BARE_WALL, build_room, wall_frame


@cache
def numbered(seed: int) -> SyntheticRoom:
    return SyntheticRoom(seed, width=160, height=120)


@pytest.fixture
def room() -> SyntheticRoom:
    return numbered(0)


@pytest.fixture(scope="module")
def bare() -> SyntheticRoom:
    return SyntheticRoom(3, frames=BARE_PASSAGE[1], width=64, height=48, bare_wall=True)


def shape(kind: int, sizes: tuple[float, float, float], T: NDArray[np.float64] | None = None) -> NDArray[np.float64]:
    scene = SceneBuilder(np.random.default_rng(0))
    scene.add(kind, np.eye(4) if T is None else T, (0, 0, 0), sizes, 0)
    return np.array(scene.shapes)


def world_points(dataset: SyntheticRoom, index: int, depth: NDArray[np.float32]) -> NDArray[np.float64]:
    points = dataset.camera.backproject(torch.from_numpy(depth).double()).numpy().reshape(-1, 3)
    T = dataset.ground_truth[index]
    return points @ T[:3, :3].T + T[:3, 3]


# ----- rays


@pytest.mark.parametrize(
    ("shapes", "origin", "direction", "expected"),
    [
        (shape(BOX, (0.5, 1.0, 2.0)), (-3.0, 0, 0), (1.0, 0, 0), 2.5),  # the face at x = -0.5
        (shape(BOX, (0.5, 1.0, 2.0)), (-3.0, 0, 0), (0, 1.0, 0), np.inf),
        (shape(BOX, (1.0, 1.0, 1.0), tilt(2, 45)), (-3.0, 0, 0), (1.0, 0, 0), 3 - np.sqrt(2)),  # an edge of the turned cube
        (shape(ELLIPSOID, (0.5, 0.5, 0.5)), (0, -2.0, 0.3), (0, 1.0, 0), 1.6),  # half chord sqrt(0.25 - 0.09) = 0.4
        (shape(ELLIPSOID, (0.2, 0.8, 0.4)), (-1.0, 0, 0), (2.0, 0, 0), 0.4),  # 0.8 m at two metres a unit
        (shape(FRUSTUM, (0.3, 0.1, 0.5)), (-1.0, 0, 0), (1.0, 0, 0), 0.8),  # radius 0.2 half way up
        (shape(FRUSTUM, (0.3, 0.1, 0.5)), (0.05, 0, 2.0), (0, 0, -1.0), 1.5),  # the top disc
        (shape(FRUSTUM, (0.3, 0.1, 0.5)), (0.2, 0, 2.0), (0, 0, -1.0), 2.0),  # beside it: the side, radius 0.2 at z = 0
    ],
)
def test_distances_worked_by_hand(
    shapes: NDArray[np.float64], origin: tuple[float, float, float], direction: tuple[float, float, float], expected: float
) -> None:
    assert hit_shape(shapes, 0, *origin, *direction) == pytest.approx(expected, abs=1e-12)


def test_hierarchy_finds_what_a_search_of_all_shapes_finds(room: SyntheticRoom) -> None:
    shapes, nodes = room.room.shapes, room.room.nodes
    rng = np.random.default_rng(0)
    for _ in range(200):
        origin, direction = rng.uniform((-1, -0.7, 1.2), (1, 0.7, 1.6)), rng.standard_normal(3)
        every = [hit_shape(shapes, i, *origin, *direction) for i in range(len(shapes))]
        for hint in (-1, int(rng.integers(len(shapes)))):
            t, found = cast(shapes, nodes, *origin, *direction, 1e3, hint)
            assert t == min(every)
            assert every[found] == t


def test_pruning_keeps_what_rays_of_a_tile_meet(room: SyntheticRoom) -> None:
    """Rays between four corners find in the pruned hierarchy what they find in the whole one."""
    shapes, nodes = room.room.shapes, room.room.nodes
    rng = np.random.default_rng(0)
    sizes = []
    for T in room.ground_truth[::20]:
        (x, y), size = rng.uniform(-0.5, 0.4, 2), 0.05
        corners = np.array([[x, y, 1], [x + size, y, 1], [x + size, y + size, 1], [x, y + size, 1]]) @ T[:3, :3].T
        leaves = np.empty_like(nodes)
        count = prune(nodes, T[None], corners[None], leaves)
        sizes.append(count)
        for weights in rng.dirichlet(np.ones(4), 50):
            ray = weights @ corners
            assert cast(shapes, leaves[:count], *T[:3, 3], *ray, 1e3, -1) == cast(shapes, nodes, *T[:3, 3], *ray, 1e3, -1)
    assert np.mean(sizes) < 0.1 * len(shapes)


def test_pruning_by_hand() -> None:
    # The camera in the origin looks along z through a tile of 0.2 x 0.2 at depth 1: at depth 5 it spans -0.5 to 0.5
    places = [(0, 0, 5), (0.9, 0, 5), (1.1, 0, 5), (0, 0, -6)]  # ahead, its edge at 0.4 inside, its edge at 0.6 outside, behind
    nodes = build_hierarchy(np.concatenate([shape(ELLIPSOID, (0.5, 0.5, 0.01), place(*p)) for p in places]))
    corners = np.array([[-0.1, -0.1, 1], [0.1, -0.1, 1], [0.1, 0.1, 1], [-0.1, 0.1, 1]])
    leaves = np.empty_like(nodes)
    count = prune(nodes, np.eye(4)[None], corners[None], leaves)
    assert sorted(leaves[:count, 7]) == [0, 1]
    assert leaves[:count, 6].tolist() == [1, 2]  # flat: after each comes the next


@pytest.mark.parametrize("kind", [BOX, FRUSTUM, ELLIPSOID])
def test_charts_and_points_invert_each_other(kind: int) -> None:
    shapes = shape(kind, (0.3, 0.2, 0.5), place(1, 2, 3, turn=20) @ tilt(0, 35))
    for chart in range(ray_casting.CHARTS):
        if chart_size(shapes, 0, chart)[0] == 0:
            continue
        for s, t in ((0.3, 0.4), (0.6, 0.7), (0.45, 0.35)):
            point = point_on(shapes, 0, chart, s, t)
            back, s_back, t_back, *normal = surface_at(shapes, 0, *point)
            assert (back, s_back, t_back) == pytest.approx((chart, s, t), abs=1e-9)
            assert np.linalg.norm(normal) == pytest.approx(1)
            ahead = np.array(point) + 0.2 * np.array(normal)
            assert hit_shape(shapes, 0, *ahead, *(-np.array(normal))) == pytest.approx(0.2, abs=1e-9)  # the normal points outwards


def test_hierarchy_of_one_shape() -> None:
    nodes = build_hierarchy(shape(ELLIPSOID, (1.0, 1.0, 1.0)))
    np.testing.assert_allclose(nodes, [[-1, -1, -1, 1, 1, 1, 1, 0]])


# ----- images


def test_depth_of_a_wall_is_its_distance(bare: SyntheticRoom) -> None:
    """In the middle of the bare passage the camera looks at the wall; a pixel's depth is (wall - eye) . n / (ray . n)."""
    index = sum(BARE_PASSAGE) // 2
    T, depth = bare.ground_truth[index], bare.render(bare.ground_truth[index]).depth
    wall = wall_frame(BARE_WALL, bare.room.half)
    rays = bare.camera.rays(bare.camera.pixels()).double().numpy() @ T[:3, :3].T
    expected = (wall[:3, 3] - T[:3, 3]) @ wall[:3, 1] / (rays @ wall[:3, 1])
    np.testing.assert_allclose(depth, expected, atol=1e-6)


def test_bare_wall_fills_the_view_and_has_one_colour(bare: SyntheticRoom) -> None:
    for index in range(*BARE_PASSAGE, 3):
        view = bare.render(bare.ground_truth[index])
        toward = view.normals @ (bare.ground_truth[index][:3, :3].T @ wall_frame(BARE_WALL, (1, 1))[:3, 1])
        assert (toward > 0.999).all()
        np.testing.assert_allclose(view.depth, view.depth.mean(), rtol=0.2)
        assert np.abs(np.diff(view.colour, axis=1)).max() < 0.02  # light alone changes over it


def test_pixels_of_one_frame_agree_with_another(room: SyntheticRoom) -> None:
    """Points of frame A projected into frame B: the depth there is the point's, to 0.1 mm, where interpolation is exact (planes)."""
    for a, b in ((40, 52), (300, 308)):
        points = world_points(room, a, room[a].depth)
        T = np.linalg.inv(room.ground_truth[b])
        uv, z = room.camera.project(torch.from_numpy(points @ T[:3, :3].T + T[:3, 3]))
        inside = room.camera.inside(uv, z).numpy()
        # rays through the projections themselves: nothing to interpolate
        rays = room.camera.rays(uv).numpy()[inside] @ room.ground_truth[b][:3, :3].T
        eye = room.ground_truth[b][:3, 3]
        seen = np.array([cast(room.room.shapes, room.room.nodes, *eye, *ray, 1e3, -1)[0] for ray in rays])
        error = np.abs(seen - z.numpy()[inside])
        assert inside.mean() > 0.6
        assert (error < 1e-4).mean() > 0.9  # the rest is hidden from B


def test_surface_agrees_with_depth_and_normals(room: SyntheticRoom) -> None:
    """Rays through pixels meet the mesh where the depth image says, to 2 mm, and on the front of its triangles."""
    surface = room.surface()
    rng = np.random.default_rng(0)
    for index in range(0, TOUR, 75):
        T = room.ground_truth[index]
        view = room.render(T)
        v, u = rng.integers(0, 120, 400), rng.integers(0, 160, 400)
        rays = room.camera.rays(torch.from_numpy(np.stack([u, v], 1)).double()).numpy() @ T[:3, :3].T
        points, ray, triangle = surface.ray.intersects_location(np.tile(T[:3, 3], (400, 1)), rays, multiple_hits=False)
        depth = (points - T[:3, 3]) @ T[:3, 2]
        agrees = np.abs(depth - view.depth[v, u][ray]) < 0.002
        front = (surface.face_normals[triangle] * (view.normals[v, u][ray] @ T[:3, :3].T)).sum(1) > 0.9
        assert len(ray) == 400
        assert agrees.mean() > 0.99  # the outline of a round shape may be missed by a hair
        assert (front | ~agrees).mean() > 0.99
    inner = np.array([*room.room.half, room.room.height])
    np.testing.assert_allclose(surface.bounds[1], inner + np.array([0.1, 0.1, 0]), atol=1e-9)  # floor and ceiling reach under the walls


def test_a_point_has_one_colour_in_all_views(room: SyntheticRoom) -> None:
    """Lambertian: the same place from two poses differs by filtering alone."""
    camera = Camera(320, 240, 288.5, 288.5, 159.5, 119.5)
    a = room.render(room.ground_truth[40], camera)
    points = camera.backproject(torch.from_numpy(a.depth)).double().numpy().reshape(-1, 3)
    T = np.linalg.inv(room.ground_truth[48]) @ room.ground_truth[40]
    b = room.render(room.ground_truth[48], camera)
    uv, z = camera.project(torch.from_numpy(points @ T[:3, :3].T + T[:3, 3]))
    u, v = uv.round().long().unbind(-1)
    ok = (camera.inside(uv, z) & (u > 0) & (v > 0) & (u < 319) & (v < 239)).numpy()
    u, v = u.numpy()[ok], v.numpy()[ok]
    same = np.abs(b.depth[v, u] - z.numpy()[ok]) < 0.01
    difference = np.abs(b.colour[v, u] - a.colour.reshape(-1, 3)[ok]).mean(1)[same]
    assert np.median(difference) < 0.02


def test_images_have_texture_and_no_bad_values() -> None:
    for seed in (0, 1):
        dataset = numbered(seed)
        for index in range(0, TOUR, 100):
            frame = dataset[index]
            assert frame.colour.dtype == frame.depth.dtype == np.float32
            assert np.isfinite(frame.colour).all()
            assert frame.colour.min() >= 0
            assert frame.colour.max() <= 1
            assert frame.depth.min() > 0.3
            assert frame.depth.max() < 8
            assert 0.2 < frame.colour.mean() < 0.8
            assert frame.colour.std() > 0.05


def test_frames_repeat_and_seeds_differ(room: SyntheticRoom) -> None:
    build_room.cache_clear()
    again, other = SyntheticRoom(0, width=160, height=120), numbered(1)
    assert again.room is not room.room
    np.testing.assert_array_equal(room[7].colour, again[7].colour)
    np.testing.assert_array_equal(room[7].depth, again[7].depth)
    assert np.abs(room[7].depth - other[7].depth).mean() > 0.1
    assert room.room.half != other.room.half


# ----- the tour


def test_fewer_frames_are_a_piece_of_the_same_tour() -> None:
    whole = tour(2, TOUR + 20, (2.6, 2.2))
    np.testing.assert_array_equal(whole[:100], tour(2, 100, (2.6, 2.2)))
    np.testing.assert_array_equal(whole[TOUR:], whole[:20])  # once more round


@pytest.mark.parametrize(("bare_wall", "turn"), [(False, 2.2), (True, 3.2)])
def test_motion_is_a_persons(bare_wall: bool, turn: float) -> None:
    for seed in range(5):
        rng = np.random.default_rng(seed)
        poses = tour(seed, TOUR + 1, (float(rng.uniform(2.45, 3)), float(rng.uniform(2.1, 2.5))), bare_wall=bare_wall)
        R = poses[:, :3, :3]
        np.testing.assert_allclose(R @ R.transpose(0, 2, 1), np.tile(np.eye(3), (len(R), 1, 1)), atol=1e-12)
        assert np.linalg.det(R) == pytest.approx(1)
        step = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
        angle = np.rad2deg(np.arccos(np.clip((np.trace(R[:-1].transpose(0, 2, 1) @ R[1:], axis1=1, axis2=2) - 1) / 2, -1, 1)))
        assert 0.006 < step.mean() < 0.014
        assert step.max() < 0.02
        assert 0.5 < angle.mean() < 1.5
        assert angle.max() < turn


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_camera_stays_clear_of_everything(seed: int) -> None:
    """No surface within 0.4 m of the camera, by rays to all sides."""
    dataset = numbered(seed)
    rng = np.random.default_rng(0)
    directions = rng.standard_normal((400, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    for T in dataset.ground_truth[::15]:
        nearest = min(cast(dataset.room.shapes, dataset.room.nodes, *T[:3, 3], *d, 1e3, -1)[0] for d in directions)
        assert nearest > 0.4


def test_the_tour_sees_every_wall(room: SyntheticRoom) -> None:
    seen = {wall: 0 for wall in range(4)}
    for index in range(0, TOUR, 20):
        yaw = np.arctan2(*room.ground_truth[index][1::-1, 2])
        seen[round((yaw + np.pi / 2) / (np.pi / 2)) % 4] += 1
    assert min(seen.values()) >= 3


# ----- the sensor


def test_axial_noise_and_quantisation_by_hand() -> None:
    # 0.0012 + 0.0019 * 1.6^2 = 0.006064 m at 2 m
    assert axial_sigma(np.array(2.0)) == pytest.approx(0.006064)
    # baseline x focal = 43.5: 2 m is 21.75 px, a whole number of eighths; 2.005 m is 21.6958 px, rounded to 21.75
    assert quantise(np.array([2.0, 2.005])) == pytest.approx([2.0, 2.0])


def test_noise_has_the_stated_statistics() -> None:
    camera = Camera(320, 240, 288.5, 288.5, 159.5, 119.5)
    depth, normals = np.full((240, 320), 2.0, np.float32), np.zeros((240, 320, 3), np.float32)
    normals[..., 2] = -1
    noisy = noisy_depth(depth, normals, camera, np.random.default_rng(0))
    assert (noisy > 0).all()
    # one step of disparity at 2 m is 4 / 43.5 / 8 = 11.5 mm: rounding adds its variance / 12
    expected = np.sqrt(0.006064**2 + 0.0115**2 / 12)
    assert noisy.std() == pytest.approx(expected, rel=0.05)
    assert noisy.mean() == pytest.approx(2.0, abs=1e-3)
    steps = 43.5 / noisy * 8
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-3)


def test_noise_leaves_holes_at_edges_grazing_angles_and_out_of_range() -> None:
    camera = Camera(64, 48, 57.7, 57.7, 31.5, 23.5)
    facing = np.zeros((48, 64, 3), np.float32)
    facing[..., 2] = -1
    depth = np.full((48, 64), 1.0, np.float32)
    depth[:, 32:] = 2.0
    noisy = noisy_depth(depth, facing, camera, np.random.default_rng(0))
    assert 0.4 < (noisy[:, 31:33] == 0).mean() < 0.8
    assert (noisy[:, :28] > 0).all()
    sideways = np.zeros_like(facing)
    sideways[..., 1] = 1  # the horizon's rays run along such a floor
    assert (noisy_depth(np.full_like(depth, 1.0), sideways, camera, np.random.default_rng(0))[23:25] == 0).all()
    for z in (0.3, 5.0):
        assert (noisy_depth(np.full_like(depth, z), facing, camera, np.random.default_rng(0)) == 0).mean() > 0.99


def test_noise_is_the_same_at_every_access() -> None:
    dataset = SyntheticRoom(0, frames=30, width=64, height=48, noise=True)
    first = dataset[11]
    dataset[3]
    again = dataset[11]
    np.testing.assert_array_equal(first.colour, again.colour)
    np.testing.assert_array_equal(first.depth, again.depth)
    exact = dataset.render(dataset.ground_truth[11])
    assert (first.depth > 0).mean() > 0.8
    assert 0 < np.abs(first.colour - exact.colour).mean() < 0.05


def test_colour_noise_has_its_size() -> None:
    grey = np.full((100, 100, 3), 0.5, np.float32)
    noisy = noisy_colour(grey, 0.0, np.random.default_rng(0))  # at time zero exposure and balance are neutral
    assert noisy.mean() == pytest.approx(0.5, abs=1e-3)
    assert noisy.std() == pytest.approx(0.012, rel=0.05)


# ----- mistakes


def test_mistakes_are_named(room: SyntheticRoom) -> None:
    with pytest.raises(FrameError, match="frame 600 does not exist"):
        room[600]
    with pytest.raises(ConfigError, match="0 frames"):
        SyntheticRoom(frames=0)
    with pytest.raises(ConfigError, match="room -1"):
        SyntheticRoom(seed=-1)
