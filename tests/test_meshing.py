from collections.abc import Callable

import numpy as np
import pytest
import torch
import trimesh
from numpy.typing import NDArray
from torch import Tensor

from idfslam.geometry.camera import Camera
from idfslam.geometry.depth_view import DepthView
from idfslam.geometry.ray_casting import RayCaster
from idfslam.mapping import meshing
from idfslam.mapping.meshing import extract_mesh, observed, touched_blocks

TR = 0.1
CAMERA = Camera(160, 120, 130.0, 130.0, 79.5, 59.5)
RADIUS = 0.4


def ball(points: Tensor) -> Tensor:
    """A ball about the origin."""
    return (points.norm(dim=-1) - RADIUS) / TR


def box(points: Tensor) -> Tensor:
    """A box of edges 1.1, 0.9, 0.7 m about the origin, seen from outside; on no lattice."""
    outside = points.abs() - torch.tensor([0.55, 0.45, 0.35], device=points.device) - 0.0037
    return (outside.clamp(min=0).norm(dim=-1) + outside.amax(-1).clamp(max=0)) / TR


def looking_at_origin(position: NDArray[np.float64]) -> NDArray[np.float64]:
    """T_wc of a camera at `position` [m] facing the origin."""
    z = -position / np.linalg.norm(position)
    x = np.cross([0.3, 1, 0.2], z)
    x /= np.linalg.norm(x)
    T_wc = np.eye(4)
    T_wc[:3, :3] = np.stack([x, np.cross(z, x), z], 1)
    T_wc[:3, 3] = position
    return T_wc


def look(sdf: Callable[[Tensor], Tensor], position: tuple[float, float, float]) -> DepthView:
    """A depth image by sphere tracing."""
    T_wc = looking_at_origin(np.array(position, float))
    rays = CAMERA.rays(CAMERA.pixels()).view(-1, 3) @ torch.tensor(T_wc[:3, :3], dtype=torch.float32).T
    depth = torch.zeros(len(rays))
    origin = torch.tensor(T_wc[:3, 3], dtype=torch.float32)
    for _ in range(100):
        depth += sdf(origin + rays * depth[:, None]) * TR / rays.norm(dim=-1)
    hit = sdf(origin + rays * depth[:, None]).abs() * TR < 1e-3
    return DepthView(T_wc, torch.where(hit & (depth < 5), depth, 0).view(CAMERA.height, CAMERA.width).numpy(), CAMERA)


AROUND = [(1.5, 0, 0), (-1.5, 0, 0), (0, 1.5, 0), (0, -1.5, 0), (0, 0, 1.5), (0, 0, -1.5)] + [
    (x, y, z) for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)
]


def test_ball_is_exact_closed_and_faces_outwards() -> None:
    mesh = extract_mesh(ball, lambda p: p + 0.5, [look(ball, p) for p in AROUND], resolution=0.02, truncation=TR)
    error = np.abs(np.linalg.norm(mesh.vertices, axis=1) - RADIUS)
    assert error.max() < 0.02 / 5
    assert mesh.is_watertight and mesh.is_winding_consistent  # many seams (blocks are 0.32 m), no doubled vertices
    assert mesh.body_count == 1 and mesh.euler_number == 2
    assert mesh.volume == pytest.approx(4 / 3 * np.pi * RADIUS**3, rel=0.01)  # positive: triangles face free space
    expected = np.round((mesh.vertices + 0.5) * 255)
    assert np.abs(mesh.visual.vertex_colors[:, :3] - expected).max() <= 1


def test_box_with_lattice_zeros_is_closed() -> None:
    def aligned(points: Tensor) -> Tensor:  # a box whose faces fall onto lattice points
        return (points.abs() - torch.tensor([0.5, 0.4, 0.3])).amax(-1) / TR

    for sdf in (box, aligned):
        mesh = extract_mesh(sdf, None, [look(sdf, p) for p in AROUND], resolution=0.02, truncation=TR)
        assert mesh.is_watertight and mesh.body_count == 1
        assert np.abs(sdf(torch.tensor(mesh.vertices, dtype=torch.float32)).numpy()).max() * TR < 0.02 / 2  # corners are cut


def test_what_nobody_observed_is_removed() -> None:
    # One camera at x = 1.5 sees the cap of the ball with x > r^2 / 1.5 = 0.1067; up to the tolerance of 6 cm in depth.
    mesh = extract_mesh(ball, None, [look(ball, (1.5, 0, 0))], resolution=0.02, truncation=TR)
    x = mesh.vertices[:, 0]
    assert x.max() == pytest.approx(RADIUS, abs=0.004)
    assert 0.1067 - 0.07 < x.min() < 0.1067 + 0.03
    assert len(np.unique(mesh.faces)) == len(mesh.vertices)  # none is left without a face


def test_votes() -> None:
    # A point at the origin, 1.5 m before the camera. Views measure a wall at 1.5 (near), 3 (seen through), 1 (hidden), or nothing.
    def wall(depth: float) -> DepthView:
        return DepthView(looking_at_origin(np.array([1.5, 0, 0])), np.full((120, 160), depth, np.float32), CAMERA)

    def kept(*depths: float) -> bool:
        return bool(observed(np.zeros((1, 3)), [wall(d) for d in depths], 0.05)[0])

    assert kept(1.5) and kept(1.54) and not kept(1.56)
    assert not kept(3.0) and not kept(1.0) and not kept(0.0)
    assert kept(1.5, 3, 3)  # two views through it are too few
    assert not kept(3.0, 3, 3)
    assert kept(1.5, 3, 3, 3)  # three times as many
    assert not kept(1.5, 3, 3, 3, 3)
    assert kept(1.5, 1, 1, 1, 0, 0)
    behind = DepthView(looking_at_origin(np.array([1.5, 0, 0])), np.full((120, 160), 1.5, np.float32), CAMERA)
    assert not observed(np.array([[3.0, 0, 0]]), [behind], 0.05)[0]


def test_touched_blocks_by_hand() -> None:
    # One reading at (0, 0, 1.1) with blocks of 1 m and margin 0.2: x and y lie in the small cell [0, 0.25], dilated [-0.2, 0.45] -> blocks
    # -1, 0; z in [1, 1.25], dilated [0.8, 1.45] -> blocks 0, 1.
    camera = Camera(1, 1, 1.0, 1.0, 0.0, 0.0)
    blocks = touched_blocks([DepthView(np.eye(4), np.full((1, 1), 1.1, np.float32), camera)], 1.0, 0.2)
    assert blocks.tolist() == [[x, y, z] for x in (-1, 0) for y in (-1, 0) for z in (0, 1)]


def test_no_views_or_no_surface_give_an_empty_mesh() -> None:
    assert len(extract_mesh(ball, lambda p: p, [], resolution=0.02, truncation=TR).vertices) == 0
    view = look(ball, (1.5, 0, 0))
    assert len(extract_mesh(lambda p: torch.ones(len(p)), None, [view], resolution=0.02, truncation=TR).faces) == 0


def test_memory_is_bounded_by_blocks_near_readings() -> None:
    # A wall of 9.85 x 7.38 m, 8 m away, at 1 cm: its blocks, not the 10 m cube, are evaluated, and never more than a batch of them at once.
    view = DepthView(np.eye(4), np.full((120, 160), 8.0, np.float32), CAMERA)
    blocks = touched_blocks([view], meshing.CELLS * 0.01, TR, stride=1)
    assert len(blocks) < 65 * 50 * 4  # of 62^3 = 238 000
    largest = 0

    def watched(points: Tensor) -> Tensor:
        nonlocal largest
        largest = max(largest, len(points))
        return (points[:, 2].neg() + 8) / TR

    extract_mesh(watched, None, [look(ball, (1.5, 0, 0))], resolution=0.01, truncation=TR)
    assert 0 < largest <= 1 << 18


def test_finer_values_make_finer_cells_where_the_surface_is_not_flat() -> None:
    """A box whose distance is 1 cm off in the lattice of whole cells. Its edges are cut half as much, and its sides have whole cells."""

    def rough(points: Tensor) -> Tensor:
        return box(points) + 0.01 / TR

    def exact(origins: NDArray[np.int64], cells: float, values: NDArray[np.float32]) -> NDArray[np.float32]:
        return box(torch.from_numpy(lattice(origins, values) * cells)).float().numpy()

    views = [look(box, p) for p in AROUND]
    fine = extract_mesh(rough, None, views, resolution=0.02, truncation=TR, refine=exact)
    coarse, halved = (extract_mesh(box, None, views, resolution=cells, truncation=TR) for cells in (0.02, 0.01))
    assert fine.is_watertight and fine.body_count == 1
    assert len(fine.faces) < 0.45 * len(halved.faces) and len(fine.faces) < 1.8 * len(coarse.faces)
    assert mean_gap(fine) < 0.6 * mean_gap(coarse)
    np.testing.assert_allclose(fine.bounds[1], np.array([0.55, 0.45, 0.35]) + 0.0037, atol=5e-4)


def lattice(origins: NDArray[np.int64], values: NDArray[np.float32]) -> NDArray[np.int64]:
    """The points (B, S, S, S, 3) [cells] of values (B, S, S, S)."""
    return origins[:, None, None, None] + np.moveaxis(np.indices(values.shape[1:]), 0, -1)


def mean_gap(mesh: trimesh.Trimesh) -> float:
    """How far [m] the edges of the box lie before the mesh, seen along the bisector of their sides: the mean."""
    half, points, inwards = np.array([0.55, 0.45, 0.35]) + 0.0037, [], []
    for axis in range(3):
        for sides in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
            corner = np.insert(np.array(sides, float), axis, 0)
            for along in np.linspace(-0.3, 0.3, 23):
                points.append(half * corner + along * np.eye(3)[axis])
                inwards.append(-corner / np.sqrt(2))
    hits = RayCaster(mesh).cast((np.array(points) - inwards).astype(np.float32), np.array(inwards, np.float32))
    return float(np.abs(hits.distance - 1).mean())


def test_between_the_points_of_a_coarse_lattice_values_are_interpolated() -> None:
    """`refine` gets `sdf` as it is where it is linear, and is asked for every point of a lattice of half cells."""
    plane, seen = torch.tensor([0.3, -0.5, 0.81]), []

    def watched(origins: NDArray[np.int64], cells: float, values: NDArray[np.float32]) -> NDArray[np.float32]:
        np.testing.assert_allclose(values, lattice(origins, values) * cells @ plane.numpy(), atol=1e-5)
        seen.append((cells, values.shape[1:]))
        return values

    mesh = extract_mesh(lambda p: p @ plane, None, [look(ball, (0, 0, 1.5))], resolution=0.02, truncation=TR, refine=watched)
    assert set(seen) == {(0.01, (17, 17, 17))}
    assert np.abs(mesh.vertices @ plane.numpy()).max(initial=0) < 1e-4


def test_finer_views_tell_what_was_observed() -> None:
    """Without any reading in them nothing was."""
    view = look(ball, (1.5, 0, 0))
    without = DepthView(view.T_wc, np.zeros_like(view.depth), view.camera)
    assert len(extract_mesh(ball, None, [view], resolution=0.02, truncation=TR, finer=iter([view])).faces) > 1000
    assert not len(extract_mesh(ball, None, [view], resolution=0.02, truncation=TR, finer=iter([without])).faces)


@pytest.mark.parametrize(("behind", "kept", "kept_by_finer"), [(0.03, True, True), (0.04, True, False), (0.05, False, False)])
def test_a_refined_mesh_ends_nearer_to_the_readings_of_finer_views(behind: float, kept: bool, kept_by_finer: bool) -> None:
    """A plane that lies `behind` [m] a wall that was read: up to 4.5 cm, and up to 3.4 cm with finer views."""
    wall = DepthView(looking_at_origin(np.array([0, 0, 1.5])), np.full((CAMERA.height, CAMERA.width), 1.5, np.float32), CAMERA)

    def triangles(finer: list[DepthView] | None) -> int:
        sdf = lambda points: (points[:, 2] + behind) / TR  # noqa: E731
        mesh = extract_mesh(sdf, None, [wall], resolution=0.02, truncation=TR, refine=lambda _, __, values: values, finer=finer)
        return len(mesh.faces)

    assert (triangles(None) > 100) == kept
    assert (triangles([wall]) > 100) == kept_by_finer
