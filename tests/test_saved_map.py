"""A map in one file: what comes back, what it can show, and files that are no map."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from safetensors import safe_open
from safetensors.torch import save_file

from helpers.plane_volume import plane_volume
from idfslam.config import FieldConfig, MapperConfig
from idfslam.errors import ResultError
from idfslam.frame import Frame
from idfslam.geometry.camera import Camera
from idfslam.geometry.depth_view import DepthView
from idfslam.graph.keyframe import Keyframe
from idfslam.mapping.field import Field
from idfslam.mapping.mapper import Mapper
from idfslam.mapping.saved_map import SavedMap, load_map, save_map
from idfslam.mapping.updates import InTurns

CAMERA = Camera(80, 60, 70.0, 70.0, 39.5, 29.5)


def poses() -> list[NDArray[np.float64]]:
    """The identity, and 10 cm to the side."""
    out = [np.eye(4), np.eye(4)]
    out[1][0, 3] = 0.1
    return out


@pytest.fixture(scope="module")
def taught() -> tuple[Field, list[DepthView]]:
    """A wall 1.2 m ahead, its left half red, its right half blue, learnt from two views."""
    torch.manual_seed(0)
    learner = Mapper(MapperConfig(), FieldConfig(table_log2=12), torch.device("cpu"), torch.Generator().manual_seed(0), InTurns())
    depth = np.full((60, 80), 1.2, np.float32)
    x = (np.arange(80) - CAMERA.cx) / CAMERA.fx * 1.2
    keyframes = []
    for T in poses():
        colour = np.where(((x + T[0, 3]) < 0)[None, :, None], [0.9, 0.1, 0.1], [0.1, 0.1, 0.9]).astype(np.float32)
        frame = Frame(0, 0.0, np.repeat(colour, 60, 0), depth, CAMERA)
        keyframes.append(Keyframe(frame, torch.from_numpy(T), torch.from_numpy(frame.depth), torch.from_numpy(frame.colour)))
    learner.optimise_map(keyframes, 250)
    return learner.field, [DepthView(T, depth, CAMERA) for T in poses()]


@pytest.fixture(scope="module")
def saved(taught: tuple[Field, list[DepthView]], tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("map") / "map.safetensors"
    save_map(path, *taught)
    return path


def test_the_field_comes_back(taught: tuple[Field, list[DepthView]], saved: Path) -> None:
    field, loaded = taught[0], load_map(saved)
    points = torch.rand(2000, 3, generator=torch.Generator().manual_seed(0)) * torch.tensor([1.0, 0.8, 1.2]) - torch.tensor([0.5, 0.4, 0.0])
    with torch.no_grad():
        (sdf, colour), (kept_sdf, kept_colour) = field(points), loaded.field(points)
    torch.testing.assert_close(kept_sdf, sdf, atol=0.01, rtol=0)  # 16-bit tables
    torch.testing.assert_close(kept_colour, colour, atol=0.01, rtol=0)
    assert loaded.field.config == field.config
    assert not any(p.requires_grad for p in loaded.field.parameters())


def test_the_views_come_back(taught: tuple[Field, list[DepthView]], saved: Path) -> None:
    views = load_map(saved).views
    assert len(views) == 2
    for view, T in zip(views, poses()):
        np.testing.assert_array_equal(view.T_wc, T)
        np.testing.assert_allclose(view.depth, 1.2, atol=0.0006)  # millimetres
        assert view.camera == CAMERA


def test_views_of_two_cameras_come_back_with_their_own(taught: tuple[Field, list[DepthView]], tmp_path: Path) -> None:
    """In turns; afterwards those of one camera stand together, in their order."""
    other = Camera(100, 72, 90.0, 88.0, 48.0, 36.0)
    depths = [np.full((60, 80), 1.2, np.float32), np.full((72, 100), 1.5, np.float32)]
    views = [DepthView(np.diag([1.0, 1.0, 1.0, 1.0 + i]), depths[i % 2], (CAMERA, other)[i % 2]) for i in range(4)]
    save_map(tmp_path / "map.safetensors", taught[0], views)
    loaded = load_map(tmp_path / "map.safetensors")
    assert [view.camera for view in loaded.views] == [CAMERA, CAMERA, other, other]
    assert [view.T_wc[3, 3] for view in loaded.views] == [1, 3, 2, 4]
    assert [view.depth.shape for view in loaded.views] == [(60, 80), (60, 80), (72, 100), (72, 100)]
    assert [round(float(view.depth.mean()), 3) for view in loaded.views] == [1.2, 1.2, 1.5, 1.5]


def test_large_views_of_several_cameras_stay_within_the_file_size(taught: tuple[Field, list[DepthView]], tmp_path: Path) -> None:
    # Reduced to 60 to 119 rows, 300 views of 118 x 118 alone would take 8.4 MB: 43 of that size have room in 1.2 MB.
    wide = Camera(118, 118, 90.0, 90.0, 58.5, 58.5)
    views = [DepthView(np.eye(4), np.ones((c.height, c.width), np.float32), c) for c in (CAMERA, wide) for _ in range(300)]
    save_map(tmp_path / "map.safetensors", taught[0], views)
    loaded = load_map(tmp_path / "map.safetensors")
    assert len(loaded.views) == 43
    assert 20 <= sum(view.camera == wide for view in loaded.views) <= 23  # evenly spread over all
    assert sum(2 * view.depth.size for view in loaded.views) < 1_200_000


def written_in_format_2(saved: Path, path: Path) -> Path:
    """The map as earlier versions wrote it: one camera for all views."""
    with safe_open(saved, "pt") as file:
        tensors = {name.replace("views.0.", "views."): file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (safe_open is no mapping)
        metadata = file.metadata()
    (camera,) = json.loads(metadata.pop("cameras"))
    save_file(tensors, path, {**metadata, "format": "2", "camera": json.dumps(camera)})
    return path


def test_a_map_of_the_format_before_is_read(saved: Path, tmp_path: Path) -> None:
    old, new = load_map(written_in_format_2(saved, tmp_path / "map.safetensors")), load_map(saved)
    assert len(old.views) == 2
    for a, b in zip(old.views, new.views):
        assert a.camera == b.camera == CAMERA
        np.testing.assert_array_equal(a.depth, b.depth)
        np.testing.assert_array_equal(a.T_wc, b.T_wc)
    assert all(torch.equal(value, new.field.state_dict()[name]) for name, value in old.field.state_dict().items())


def test_mesh_lies_on_the_wall(saved: Path) -> None:
    mesh = load_map(saved).mesh(0.04)
    assert len(mesh.faces) > 200
    np.testing.assert_allclose(mesh.vertices[:, 2], 1.2, atol=0.02)
    colours, x = mesh.visual.vertex_colors, mesh.vertices[:, 0]
    assert (colours[x < -0.15, 0] > colours[x < -0.15, 2]).mean() > 0.95  # red on the left
    assert (colours[x > 0.15, 0] < colours[x > 0.15, 2]).mean() > 0.95


def test_the_fused_surface_replaces_the_networks_where_it_is_trusted(taught: tuple[Field, list[DepthView]], tmp_path: Path) -> None:
    """A volume that saw the middle of the wall 8 mm nearer, with full trust; around it the mesh is the network's, without a gap."""
    field, views = taught
    save_map(tmp_path / "map.safetensors", field, views, plane_volume(1.192, range(-2, 2)))
    saved, alone = load_map(tmp_path / "map.safetensors"), SavedMap(field, views)
    assert saved.volume is not None and saved.volume.blocks.shape == (48, 3)
    mesh = saved.mesh(0.02)
    middle = (np.abs(mesh.vertices[:, :2]) < 0.14).all(1)
    assert middle.sum() > 100
    np.testing.assert_allclose(mesh.vertices[middle, 2], 1.192, atol=2e-4)
    assert mesh.area == pytest.approx(alone.mesh(0.02).area, rel=0.03)
    assert len(mesh.split(only_watertight=False)) == 1
    camera = Camera(24, 16, 50.0, 50.0, 11.5, 7.5)
    depth, of_network = saved.render(np.eye(4), camera)[1], alone.render(np.eye(4), camera)[1]
    np.testing.assert_allclose(depth[6:10, 9:15], 1.192, atol=5e-4)
    assert np.abs(of_network[6:10, 9:15] - 1.192).max() > 1e-3


def test_render_shows_the_wall(saved: Path) -> None:
    camera = Camera(24, 16, 25.0, 25.0, 11.5, 7.5)  # not the recording's
    colour, depth = load_map(saved).render(np.eye(4), camera)
    assert (colour.shape, depth.shape) == ((16, 24, 3), (16, 24))
    assert (colour.dtype, depth.dtype) == (np.float32, np.float32)
    assert np.median(np.abs(depth - 1.2)) < 0.03
    assert colour[8, 3, 0] > 0.6 > 0.4 > colour[8, 3, 2]
    assert colour[8, 20, 2] > 0.6 > 0.4 > colour[8, 20, 0]


def test_tables_that_grew_come_back(taught: tuple[Field, list[DepthView]], tmp_path: Path) -> None:
    torch.manual_seed(0)
    field = Field(FieldConfig(table_log2=8))
    field.encoding.double_tables()
    save_map(tmp_path / "map.safetensors", field, taught[1])
    assert load_map(tmp_path / "map.safetensors").field.encoding.tables.shape[1] == 512


def test_a_field_without_a_grid_comes_back_exactly(taught: tuple[Field, list[DepthView]], tmp_path: Path) -> None:
    torch.manual_seed(0)
    field = Field(FieldConfig(encoding="positional", layers=3, width=32, direction_frequencies=2))
    save_map(tmp_path / "map.safetensors", field, taught[1])
    kept = load_map(tmp_path / "map.safetensors").field.state_dict()
    assert all(torch.equal(kept[name], value) for name, value in field.state_dict().items())


def refused(path: Path) -> str:
    with pytest.raises(ResultError) as caught:
        load_map(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def rewritten(saved: Path, path: Path, *, drop: str = "", **metadata: str) -> Path:
    """The saved map without a tensor, or with other metadata."""
    with safe_open(saved, "pt") as file:
        tensors = {name: file.get_tensor(name) for name in file.keys() if name != drop}  # noqa: SIM118 (safe_open is no mapping)
        save_file(tensors, path, {**file.metadata(), **metadata})
    return path


def test_another_version(saved: Path, tmp_path: Path) -> None:
    assert "map format 99, expected 3; use the version" in refused(rewritten(saved, tmp_path / "map.safetensors", format="99"))


def test_truncated(saved: Path, tmp_path: Path) -> None:
    path = tmp_path / "map.safetensors"
    for length in (0, 5, 100, saved.stat().st_size // 2, saved.stat().st_size - 1):
        path.write_bytes(saved.read_bytes()[:length])
        assert "cannot be read as a map" in refused(path)


def test_other_files(saved: Path, tmp_path: Path) -> None:
    path = tmp_path / "weights.safetensors"
    save_file({"weight": torch.zeros(3)}, path)
    assert "map format none, expected 3" in refused(path)
    (tmp_path / "mesh.ply").write_bytes(b"ply\nformat ascii 1.0\n" * 20)
    refused(tmp_path / "mesh.ply")
    refused(tmp_path / "missing.safetensors")
    refused(tmp_path)


@pytest.mark.parametrize("name", ["field.encoding.tables", "field.sdf_head.bias", "views.0.depth", "views.0.T_wc"])
def test_a_tensor_is_missing(saved: Path, tmp_path: Path, name: str) -> None:
    refused(rewritten(saved, tmp_path / "map.safetensors", drop=name))


@pytest.mark.parametrize(
    "cameras", ["{", "[]", "[{}]", "{}", '[{"width": 80}]', '[{"width": 8, "height": 6, "fx": 7, "fy": 7, "cx": 4, "cy": 3}]']
)
def test_damaged_cameras(saved: Path, tmp_path: Path, cameras: str) -> None:
    refused(rewritten(saved, tmp_path / "map.safetensors", cameras=cameras))


@pytest.mark.parametrize("field", ["{", "[]", '{"layers": 2}', '{"no_such_key": 1}', '{"width": "wide"}'])
def test_damaged_metadata(saved: Path, tmp_path: Path, field: str) -> None:
    refused(rewritten(saved, tmp_path / "map.safetensors", field=field))
