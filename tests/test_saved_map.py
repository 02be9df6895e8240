"""Maps in files: what is written comes back; what cannot be read says so in one line. Sphere tracing against a known sphere."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file

from idfslam.config import FieldConfig
from idfslam.errors import ResultError
from idfslam.geometry.camera import Camera
from idfslam.mapping.field import Field
from idfslam.mapping.meshing import View
from idfslam.mapping.saved_map import FORMAT, load_map, mesh_of, save_map
from idfslam.mapping.sphere_tracing import trace, trace_image

CAMERA = Camera(160, 120, 140.0, 140.0, 79.5, 59.5)
WALL = 1.5  # depth of the wall that the field is taught [m]
GRID = FieldConfig(levels=4, table_log2=12)
POSITIONAL = FieldConfig(encoding="positional", direction_frequencies=2, layers=2, width=16, skip=2, colour_width=8)


def wall_field(config: FieldConfig) -> Field:
    """A field whose T-SDF is (WALL - z) / tr, clamped, about the wall, by 150 steps of Adam."""
    torch.manual_seed(0)
    field = Field(config)
    adam = torch.optim.Adam(field.parameters(), lr=0.01)
    for _ in range(150):
        points = (torch.rand(2000, 3) - 0.5) * 2.5
        points[:, 2] = WALL + (torch.rand(2000) - 0.5) * 0.4
        points[::4, 2] = torch.rand(500) * WALL
        target = ((WALL - points[:, 2]) / config.truncation).clamp(-1, 1)
        adam.zero_grad()
        (field.sdf(points) - target).square().mean().backward()
        adam.step()
        if config.encoding == "grid":
            field.encoding.tables.data -= 0.5 * field.encoding.gradient
            field.encoding.gradient.zero_()
    return field.requires_grad_(False)


def wall_views(count: int = 3) -> list[View]:
    """The wall from cameras that face it, 1 cm apart to the right."""
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, 0, 3] = 0.01 * np.arange(count)
    return [View(pose, np.full((CAMERA.height, CAMERA.width), WALL, np.float32), CAMERA) for pose in poses]


@pytest.fixture(scope="module")
def wall() -> Field:
    return wall_field(GRID)


@pytest.fixture
def saved(wall: Field, tmp_path: Path) -> Path:
    path = tmp_path / "map.safetensors"
    save_map(path, wall, wall_views())
    return path


def test_what_is_saved_comes_back(wall: Field, saved: Path) -> None:
    loaded = load_map(saved)
    points = torch.rand(500, 3) * torch.tensor([1.0, 1.0, 2.0])
    # Tables in float16 keep 11 bits: features of about 1 are off by no more than 0.0005, and a few dozen of them are added up.
    assert torch.allclose(loaded.field.sdf(points), wall.sdf(points), atol=0.01)
    assert torch.allclose(loaded.field(points)[1], wall(points)[1], atol=0.01)
    assert len(loaded.views) == 3
    assert loaded.views[2].T_wc[0, 3] == 0.02
    assert np.all(loaded.views[0].depth == np.float32(WALL))


def test_mesh_is_the_wall(wall: Field, saved: Path) -> None:
    mesh = load_map(saved).mesh(0.05)
    # The camera sees 1.5 / 140 * 160 = 1.71 m by 1.29 m of the wall; a cell and a reduced pixel more or less at each edge.
    assert abs(mesh.area - 1.71 * 1.29) < 0.35
    assert np.abs(mesh.vertices[:, 2] - WALL).max() < 0.03
    assert (mesh.face_normals[:, 2] < 0).mean() > 0.99  # towards the camera
    assert mesh.visual.vertex_colors.shape == (len(mesh.vertices), 4)
    direct = mesh_of(wall, wall_views(), 0.05)
    assert abs(mesh.area - direct.area) < 0.15


def test_render_shows_the_wall(saved: Path) -> None:
    small = CAMERA.resized(40, 30)
    colour, depth = load_map(saved).render(np.eye(4), small)
    assert colour.shape == (30, 40, 3)
    assert colour.dtype == depth.dtype == np.float32
    assert np.abs(depth - WALL).max() < 0.03
    away = np.diag([-1.0, 1.0, -1.0, 1.0])  # turned round: nothing was ever taught there
    assert load_map(saved).render(away, small)[1].shape == (30, 40)


def test_field_whose_colour_depends_on_the_view(tmp_path: Path) -> None:
    field = wall_field(POSITIONAL)
    save_map(tmp_path / "map", field, wall_views())
    loaded = load_map(tmp_path / "map")
    points = torch.rand(50, 3)
    assert torch.equal(loaded.field.sdf(points), field.sdf(points))  # nothing of it is rounded
    assert loaded.mesh(0.1).visual.vertex_colors.shape[1] == 4
    assert loaded.render(np.eye(4), CAMERA.resized(16, 12))[0].shape == (12, 16, 3)


def test_largest_map_stays_below_10_mb(tmp_path: Path) -> None:
    view = View(np.eye(4), np.ones((480, 640), np.float32), Camera(640, 480, 525.0, 525.0, 319.5, 239.5))
    save_map(tmp_path / "map", Field(FieldConfig(table_log2=FieldConfig.table_log2_max)), [view] * 500)
    assert (tmp_path / "map").stat().st_size < 10_000_000
    loaded = load_map(tmp_path / "map")
    assert len(loaded.views) == 125  # 1.2 MB of 60 x 80 pixels of 2 bytes
    # Every 8th pixel from the 4th on: u = 8 u' + 4, so fx' = 525 / 8 and cx' = (319.5 - 4) / 8.
    assert loaded.views[0].camera == Camera(80, 60, 65.625, 65.625, 39.4375, 29.4375)


def altered(path: Path, *, metadata: dict[str, str | None] | None = None, drop: str = "", **tensors: torch.Tensor) -> Path:
    """The map with other metadata (None: without it) and tensors ('__' stands for '.')."""
    from safetensors import safe_open

    with safe_open(path, "pt") as file:
        told = {key: value for key, value in (file.metadata() | (metadata or {})).items() if value is not None}
    held = load_file(path) | {name.replace("__", "."): tensor for name, tensor in tensors.items()}
    held.pop(drop, None)
    save_file(held, path, told)
    return path


def refused(path: Path, *words: str) -> None:
    with pytest.raises(ResultError) as caught:
        load_map(path)
    message = str(caught.value)
    assert "\n" not in message
    for word in (str(path), *words):
        assert word in message


def test_other_version_is_refused(saved: Path) -> None:
    refused(altered(saved, metadata={"format": "99"}), f"map format 99, expected {FORMAT}")


def test_tensors_of_something_else_are_refused(saved: Path) -> None:
    refused(altered(saved, metadata={"format": None}), "map format none")


def test_damaged_files_are_refused(saved: Path, tmp_path: Path) -> None:
    whole = saved.read_bytes()
    for name, content in {"cut": whole[: len(whole) // 2], "empty": b"", "text": b"no tensors" * 100}.items():
        (tmp_path / name).write_bytes(content)
        refused(tmp_path / name, "cannot be read as a map")
    refused(tmp_path / "absent", "cannot be read as a map")


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"metadata": {"field": None}}, "field"),
        ({"metadata": {"field": "no json"}}, "JSON"),
        ({"metadata": {"field": "[]"}}, "cannot be read"),
        ({"metadata": {"field": json.dumps({"depth": 3})}}, "unknown key 'depth'"),
        ({"metadata": {"camera": json.dumps({"width": 3})}}, "missing"),
        ({"drop": "field.sdf_head.bias"}, "field.sdf_head.bias is missing, expected (1,)"),
        ({"drop": "views.T_wc"}, "views.T_wc"),
        ({"field__sdf_head__bias": torch.zeros(2)}, "field.sdf_head.bias is (2,), expected (1,)"),
        ({"field__sdf_head__bias": torch.full((1,), torch.nan)}, "not finite"),
        ({"field__more": torch.zeros(2)}, "field.more is (2,), expected none"),
        ({"views__T_wc": torch.zeros(2, 4, 4)}, "views have poses (2, 4, 4)"),
    ],
)
def test_maps_that_do_not_fit_together_are_refused(saved: Path, changes: dict, word: str) -> None:
    refused(altered(saved, **changes), word)


def sphere(points: torch.Tensor) -> torch.Tensor:
    """T-SDF of a ball of radius 0.5 m, 2 m ahead, tr = 0.1 m."""
    return (((points - torch.tensor([0.0, 0.0, 2.0])).norm(dim=-1) - 0.5) / 0.1).clamp(-1, 1)


def test_tracing_meets_a_sphere() -> None:
    directions = torch.tensor([[0.0, 0.0, 1.0], [0.15, 0.0, 1.0], [0.0, 0.0, 2.0], [1.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    depth = trace(sphere, torch.zeros(5, 3), directions, near=0.05, far=5.0, truncation=0.1)
    # Along (0.15, 0, 1): |t d - c|^2 = 0.25 gives 1.0225 t^2 - 4 t + 3.75 = 0, t = (4 - sqrt(0.6625)) / 2.045 = 1.55797.
    # Twice the direction: half the depth. The last two miss.
    assert depth.tolist() == pytest.approx([1.5, 1.55797, 0.75, 0, 0], abs=1e-3)


def test_tracing_ends_at_far_and_starts_behind_a_surface() -> None:
    ahead = torch.tensor([[0.0, 0.0, 1.0]])
    assert trace(sphere, torch.zeros(1, 3), ahead, near=0.05, far=1.4, truncation=0.1).tolist() == [0]
    # From the ball's middle there is no way from before the surface behind it.
    assert trace(sphere, torch.tensor([[0.0, 0.0, 2.0]]), ahead, near=0.05, far=5.0, truncation=0.1).tolist() == [0]


def test_traced_image_is_black_beside_the_sphere() -> None:
    camera = Camera(21, 11, 10.0, 10.0, 10.0, 5.0)
    image = trace_image(sphere, lambda p, d: torch.ones_like(p), torch.eye(4), camera, far=5.0, truncation=0.1, rays_a_chunk=50)
    assert image.depth[5, 10] == pytest.approx(1.5, abs=1e-3)
    assert image.depth[0, 0] == 0
    assert torch.equal(image.colour.sum(-1) > 0, image.depth > 0)
