"""Exports upright and in the right colours: axes, colour spaces, normals, materials and clean triangles, by formula."""

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from helpers.box_room import BOX, box_poses
from idfslam.cli import command_line
from idfslam.datasets.poses.pose_file import read_pose_file
from idfslam.export.mesh_files import linear
from idfslam.export.surface import cleaned, turned
from idfslam.geometry.level import level
from idfslam.geometry.trajectory import load_tum
from idfslam.geometry.transforms_json import read_transforms
from idfslam.runs import result_folder

Y_UP = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])  # glTF's axes of a vector with z up
FORMATS = ("tum", "kitti", "nerfstudio", "colmap", "ply", "obj", "glb", "points", "grid", "blocks")
UPS = ("z", "y", "camera")


@pytest.fixture(scope="module")
def exports(known_run: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The same run with each kind of axes."""
    folders = {up: tmp_path_factory.mktemp(up) for up in UPS}
    for up, folder in folders.items():
        arguments = ("--to", *FORMATS, "--resolution", "0.08", "--up", up, "--out", str(folder))
        command_line.main(["export", str(known_run), *arguments])
    return folders


def gltf(path: Path) -> tuple[dict, dict[str, NDArray]]:
    """The JSON of a GLB file and the arrays of its one primitive, read by the rules of glTF 2.0."""
    data = path.read_bytes()
    size = int.from_bytes(data[12:16], "little")
    tree, binary = json.loads(data[20 : 20 + size]), data[28 + size :]
    primitive = tree["meshes"][0]["primitives"][0]
    arrays = {}
    for name, number in {**primitive["attributes"], "indices": primitive["indices"]}.items():
        accessor = tree["accessors"][number]
        view = tree["bufferViews"][accessor["bufferView"]]
        kind = {5121: np.uint8, 5125: np.uint32, 5126: np.float32}[accessor["componentType"]]
        columns = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}[accessor["type"]]
        start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        arrays[name] = np.frombuffer(binary, kind, accessor["count"] * columns, start).reshape(-1, columns)
    return tree, arrays


def ply(path: Path) -> trimesh.Trimesh:
    return trimesh.load(path, process=False)


def record(folder: Path) -> dict:
    return json.loads((folder / "transform.json").read_text())


def on_the_walls(points: NDArray) -> NDArray:
    return np.abs(np.abs(points) - BOX).min(-1)


def test_z_or_y_is_up_and_the_first_camera_the_origin(exports: dict[str, Path]) -> None:
    """The first camera stands upright in the box, which has its y down."""
    assert {up: record(folder)["up"] for up, folder in exports.items()} == dict(zip(UPS, UPS))
    T = {up: np.array(record(folder)["T_export_world"]) for up, folder in exports.items()}
    np.testing.assert_array_equal(T["camera"], np.eye(4))
    np.testing.assert_allclose(T["z"][2], [0, -1, 0, 0], atol=1e-9)
    np.testing.assert_allclose(T["y"][1], [0, -1, 0, 0], atol=1e-9)
    np.testing.assert_allclose(T["y"][:3, :3], Y_UP @ T["z"][:3, :3], atol=1e-12)
    for up in UPS:
        assert np.linalg.det(T[up][:3, :3]) == pytest.approx(1)


def test_the_floor_decides_what_is_up() -> None:
    """A floor seen by a camera that looks down by 25 degrees, and the same wall without floor."""
    floor = trimesh.creation.box((4, 0.02, 4))
    tilt = trimesh.transformations.rotation_matrix(np.deg2rad(25), [1, 0, 0])
    floor.apply_transform(tilt)
    found = level(floor, np.eye(4)[None])
    assert found.by_gravity
    assert found.R_lw[2] @ (tilt[:3, :3] @ [0, -1, 0]) == pytest.approx(1, abs=1e-6)
    steep = trimesh.transformations.rotation_matrix(np.deg2rad(25), [1, 0, 0]) @ tilt
    desk = trimesh.Trimesh([[-1, 0, 1], [1, 0, 1], [0, 0, 3]], [[0, 2, 1]]).apply_transform(
        steep
    )  # seen from 50 degrees above, as on a desk
    down = level(desk, np.eye(4)[None])
    assert down.by_gravity
    assert down.R_lw[2] @ (steep[:3, :3] @ [0, -1, 0]) == pytest.approx(1, abs=1e-6)
    wall = trimesh.Trimesh([[0, 0, 2], [1, 0, 2], [0, 1, 2]], [[0, 2, 1]])
    bare = level(wall, np.eye(4)[None])
    assert not bare.by_gravity
    np.testing.assert_allclose(bare.R_lw[2], [0, -1, 0], atol=1e-12)
    assert not level(None, np.eye(4)[None]).by_gravity


@pytest.mark.parametrize("up", UPS)
def test_poses_points_and_meshes_of_one_command_fit(exports: dict[str, Path], up: str) -> None:
    folder = exports[up]
    T_ew = np.array(record(folder)["T_export_world"])
    expected = T_ew @ box_poses()
    np.testing.assert_allclose(load_tum(folder / "tum.txt").poses, expected, atol=1e-8)
    np.testing.assert_allclose(read_pose_file(folder / "kitti.txt").T_wc, expected, atol=1e-8)
    np.testing.assert_allclose(read_transforms(folder / "nerfstudio" / "transforms.json")[0], expected[[0, 6, 13]], atol=1e-12)
    for name in ("mesh.ply", "mesh.obj", "points.ply", "nerfstudio/points.ply"):
        points = np.asarray(ply(folder / name).vertices) @ T_ew[:3, :3]
        assert np.median(on_the_walls(points)) < 0.01, name


def test_glb_has_y_up_whatever_the_axes_are(exports: dict[str, Path]) -> None:
    """Turned by an importer from y up to z up, it lies on the PLY of the same command."""
    for up in UPS:
        tree, arrays = gltf(exports[up] / "mesh.glb")
        assert all("matrix" not in node or np.allclose(node["matrix"], np.eye(4).ravel()) for node in tree["nodes"])
        T_gw = np.array(record(exports[up])["exports"]["glb"]["T_export_world"])
        assert record(exports[up])["exports"]["glb"]["up"] == "y"
        np.testing.assert_allclose(T_gw[1], [0, -1, 0, 0], atol=1e-9)
        assert np.median(on_the_walls(arrays["POSITION"] @ T_gw[:3, :3])) < 0.01
    imported = gltf(exports["z"] / "mesh.glb")[1]["POSITION"] @ Y_UP
    np.testing.assert_allclose(imported, ply(exports["z"] / "mesh.ply").vertices, atol=1e-6)


def test_the_grid_has_the_axes_of_the_mesh(exports: dict[str, Path]) -> None:
    """The map is asked at the turned lattice: half way from the middle to the walls it is as far from them as it says."""
    for up in UPS:
        grid = np.load(exports[up] / "grid.npz")
        T_ew = np.array(record(exports[up])["T_export_world"])
        np.testing.assert_allclose(grid["T_export_world"], T_ew, atol=1e-12)
        lattice = np.stack(np.meshgrid(*map(np.arange, grid["tsdf"].shape), indexing="ij"), -1)
        points = (grid["origin"] + lattice * float(grid["voxel_size"])) @ T_ew[:3, :3]
        inside = (np.abs(points) < BOX).all(-1)
        distance = (BOX - np.abs(points)).min(-1)
        near = grid["observed"] & inside & (distance < 0.06)
        assert near.sum() > 100
        assert np.median(np.abs(grid["tsdf"][near] * 0.06 - distance[near])) < 0.01


def test_glb_colours_are_linear_and_matte(exports: dict[str, Path]) -> None:
    """glTF 2.0, 3.7.2.1: COLOR_0 is linear; 3.9.2: without a material a mesh is metal."""
    tree, arrays = gltf(exports["z"] / "mesh.glb")
    srgb = np.asarray(ply(exports["z"] / "mesh.ply").visual.vertex_colors)[:, :3] / 255
    expected = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    assert np.abs(arrays["COLOR_0"][:, :3] / 255 - expected).max() <= 0.5 / 255 + 1e-9
    assert (arrays["COLOR_0"][:, 3] == 255).all()
    material = tree["materials"][tree["meshes"][0]["primitives"][0]["material"]]
    assert material["pbrMetallicRoughness"] == {"metallicFactor": 0.0, "roughnessFactor": 1.0}
    assert tree["asset"]["version"] == "2.0"


def test_colours_of_the_standard() -> None:
    """Values of IEC 61966-2-1: 188 of 255 is half the light."""
    colours = np.array([[0, 10, 188, 77], [255, 128, 55, 255]], np.uint8)
    assert linear(colours).tolist() == [[0, 1, 128, 77], [255, 55, 10, 255]]


def test_textured_glb_is_matte_with_a_texture_of_srgb(known_run: Path, tmp_path: Path) -> None:
    command_line.main(["export", str(known_run), "--to", "glb", "obj", "--texture", "map", "--resolution", "0.1", "--out", str(tmp_path)])
    tree, arrays = gltf(tmp_path / "mesh.glb")
    (material,) = tree["materials"]
    pbr = material["pbrMetallicRoughness"]
    assert (pbr["metallicFactor"], pbr["roughnessFactor"], pbr["baseColorTexture"]) == (0.0, 1.0, {"index": 0})
    assert [texture["sampler"] for texture in tree["textures"]] == [0]
    assert tree["samplers"][0]["minFilter"] == 9729  # linear: no mip levels
    assert set(arrays) == {"POSITION", "NORMAL", "TEXCOORD_0", "indices"}
    np.testing.assert_allclose(np.linalg.norm(arrays["NORMAL"], axis=1), 1, atol=1e-5)
    assert (tmp_path / "mesh.mtl").read_text() == "newmtl mesh\nKa 0 0 0\nKd 1 1 1\nKs 0 0 0\nNs 0\nillum 1\nmap_Kd mesh.png\n"
    text = (tmp_path / "mesh.obj").read_text()
    assert "mtllib mesh.mtl\nusemtl mesh\n" in text
    assert "\nvn " in text


@pytest.mark.parametrize("name", ["mesh.ply", "mesh.obj", "mesh.glb", "points.ply"])
def test_normals_are_unit_and_point_into_the_room(exports: dict[str, Path], name: str) -> None:
    folder = exports["camera"]
    if name.endswith("glb"):
        arrays = gltf(folder / name)[1]
        points, normals = arrays["POSITION"] * [1, -1, -1], arrays["NORMAL"] * [1, -1, -1]
    elif name.endswith("obj"):
        rows = [line.split() for line in (folder / name).read_text().splitlines()]
        points = np.array([row[1:4] for row in rows if row and row[0] == "v"], float)
        normals = np.array([row[1:4] for row in rows if row and row[0] == "vn"], float)
    else:
        rows = ply(folder / name).metadata["_ply_raw"]["vertex"]["data"]
        points, normals = (np.stack([rows[axis] for axis in axes], -1) for axes in (("x", "y", "z"), ("nx", "ny", "nz")))
    assert len(normals) == len(points) > 300
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-5)
    wall = np.abs(np.abs(points) - BOX).argmin(1)
    inwards = -np.sign(points) * np.eye(3)[wall]
    assert np.median((normals * inwards).sum(1)) > 0.98
    assert ((normals * inwards).sum(1) > 0).mean() > 0.98


def test_a_mesh_has_no_face_without_area_and_none_twice() -> None:
    """A square with one face twice, one turned over, one collapsed, one a sliver, and one corner as two vertices."""
    corners = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [1, 1 + 1e-9, 0], [0.5, 0, 0], [7, 7, 7]]
    faces = [[0, 1, 2], [0, 4, 3], [1, 2, 0], [2, 1, 0], [0, 1, 1], [0, 5, 1]]
    colours = np.arange(28, dtype=np.uint8).reshape(7, 4)
    mesh = cleaned(trimesh.Trimesh(corners, faces, vertex_colors=colours, process=False))
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3]]
    np.testing.assert_array_equal(mesh.vertices, corners[:4])
    np.testing.assert_array_equal(mesh.visual.vertex_colors, colours[:4])
    np.testing.assert_allclose(mesh.vertex_normals, [[0, 0, 1]] * 4, atol=1e-12)


def test_normals_turn_with_the_mesh() -> None:
    mesh = cleaned(trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], process=False))
    T = trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0])
    T[:3, 3] = [1, 2, 3]
    out = turned(mesh, T)
    np.testing.assert_allclose(out.vertices, [[1, 2, 3], [2, 2, 3], [1, 2, 4]], atol=1e-12)
    np.testing.assert_allclose(out.vertex_normals, [[0, -1, 0]] * 3, atol=1e-12)


def test_the_mesh_of_a_run_keeps_the_axes_of_its_trajectory(known_run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    import shutil

    own = shutil.copytree(known_run, tmp_path / "own")
    command_line.main(["mesh", str(own), "--resolution", "0.1"])
    assert np.median(on_the_walls(np.asarray(ply(own / result_folder.MESH).vertices))) < 0.01
    command_line.main(["mesh", str(own), "--resolution", "0.1", "--out", str(tmp_path / "upright.ply")])
    T_lw = level(ply(own / result_folder.MESH), box_poses()).R_lw
    assert np.median(on_the_walls(np.asarray(ply(tmp_path / "upright.ply").vertices) @ T_lw)) < 0.01
    for arguments, message in (
        (("--up", "z"), "mesh.ply keeps the axes of trajectory.txt; name another file with --out"),
        (("--out", str(tmp_path / "upright.ply")), "upright.ply: exists already; choose another file with --out, or replace it with"),
    ):
        capsys.readouterr()
        with pytest.raises(SystemExit):
            command_line.main(["mesh", str(own), "--resolution", "0.1", *arguments])
        error = capsys.readouterr().err
        assert message in error
        assert error.count("\n") == 1
    command_line.main(["mesh", str(own), "--resolution", "0.1", "--out", str(tmp_path / "upright.ply"), "--overwrite", "--up", "camera"])
    assert np.median(on_the_walls(np.asarray(ply(tmp_path / "upright.ply").vertices))) < 0.01
