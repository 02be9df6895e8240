"""A run for other programs: exact numbers, conventions proven by projection, files that open again."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from helpers.box_room import BOX, BOX_FRAMES, BOX_HEIGHT, BOX_WIDTH, box_poses
from helpers.known_run import KNOWN_INTERPOLATED, KNOWN_KEYFRAMES, KNOWN_LOST
from idfslam.cli import command_line
from idfslam.datasets.poses.pose_file import read_pose_file
from idfslam.geometry.camera import Camera
from idfslam.geometry.kitti import save_kitti
from idfslam.geometry.ray_casting import RayCaster, pixel_rays
from idfslam.geometry.trajectory import load_tum
from idfslam.geometry.transforms_json import read_transforms
from idfslam.runs.keyframes_file import read_keyframes
from idfslam.runs.run_config import write_config

UP = np.diag([1.0, -1.0, -1.0, 1.0])


def export(run: Path, *arguments: str | Path) -> None:
    command_line.main(["export", str(run), *map(str, arguments)])


@pytest.fixture(scope="module")
def exported(known_run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("export")
    formats = ("tum", "kitti", "nerfstudio", "colmap", "ply", "obj", "glb", "points", "grid", "blocks")
    export(known_run, "--to", *formats, "--resolution", "0.06", "--up", "camera", "--out", out)
    return out


def on_the_walls(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N,) distances [m] to the box."""
    return np.abs(np.abs(points) - BOX).min(-1)


def test_tum_and_kitti(exported: Path) -> None:
    np.testing.assert_allclose(load_tum(exported / "tum.txt").poses, box_poses(), atol=1e-8)
    np.testing.assert_allclose(read_pose_file(exported / "kitti.txt").T_wc, box_poses(), atol=1e-8)
    times = np.loadtxt(exported / "kitti_times.txt")
    np.testing.assert_allclose(times, np.arange(BOX_FRAMES) / 30, atol=1e-6)


def test_a_kitti_line_is_three_rows_of_the_pose(tmp_path: Path) -> None:
    T = np.eye(4)
    T[:3] = [[0, -1, 0, 1.5], [1, 0, 0, -2], [0, 0, 1, 0.25]]
    save_kitti(tmp_path / "poses.txt", T[None])
    assert (tmp_path / "poses.txt").read_text() == "0 -1 0 1.5 1 0 0 -2 0 0 1 0.25\n"


def test_nerfstudio(exported: Path) -> None:
    folder = exported / "nerfstudio"
    values = json.loads((folder / "transforms.json").read_text())
    assert [frame["file_path"] for frame in values["frames"]] == [f"images/{i:06d}.png" for i in KNOWN_KEYFRAMES]
    for frame, i in zip(values["frames"], KNOWN_KEYFRAMES):
        assert cv2.imread(str(folder / frame["file_path"])).shape == (BOX_HEIGHT, BOX_WIDTH, 3)
        depth = cv2.imread(str(folder / frame["depth_file_path"]), cv2.IMREAD_UNCHANGED)
        assert depth.dtype == np.uint16
        # A pixel's centre lies at (u + 1/2, v + 1/2) there, and its camera looks along -z: the point that it sees lies on a wall
        u, v = 20, 90
        x, y = (u + 0.5 - values["cx"]) / values["fl_x"], (v + 0.5 - values["cy"]) / values["fl_y"]
        z = depth[v, u] * values["depth_unit_scale_factor"]
        point = np.array(frame["transform_matrix"]) @ [x * z, -y * z, -z, 1]
        assert on_the_walls(point[None, :3])[0] < 0.001
        np.testing.assert_allclose(np.array(frame["transform_matrix"]) @ UP, box_poses()[i], atol=1e-12)
    assert len(trimesh.load(folder / values["ply_file_path"]).vertices) > 500


def test_transforms_come_back(exported: Path, known_run: Path) -> None:
    poses, camera = read_transforms(exported / "nerfstudio" / "transforms.json")
    np.testing.assert_allclose(poses, box_poses()[list(KNOWN_KEYFRAMES)], atol=1e-12)
    assert camera == read_keyframes(known_run).camera


def test_colmap(exported: Path) -> None:
    """Points projected by the formulas of COLMAP's documentation fall on their own pixels, and on the colour there."""
    folder = exported / "colmap" / "sparse" / "0"
    lines = {name: (folder / f"{name}.txt").read_text().splitlines()[1:] for name in ("cameras", "images", "points3D")}
    assert lines["cameras"][0].split()[:4] == ["1", "PINHOLE", str(BOX_WIDTH), str(BOX_HEIGHT)]
    fx, fy, cx, cy = map(float, lines["cameras"][0].split()[4:])
    assert (cx, cy) == (BOX_WIDTH / 2, BOX_HEIGHT / 2)  # COLMAP's pixel centres lie at half integers
    points = {int(words[0]): words for words in (line.split() for line in lines["points3D"])}
    tracks = {i: {tuple(map(int, words[k : k + 2])) for k in range(8, len(words), 2)} for i, words in points.items()}
    assert min(map(len, tracks.values())) >= 2
    assert len(lines["images"]) == 2 * len(KNOWN_KEYFRAMES)
    worst, observations = 0.0, 0
    for head, body in zip(lines["images"][::2], lines["images"][1::2]):
        words = head.split()
        w, x, y, z, *t = map(float, words[1:8])
        R = Rotation.from_quat([x, y, z, w]).as_matrix()
        assert (exported / "colmap" / "images" / words[9]).is_file()
        seen = np.array(body.split(), float).reshape(-1, 3)
        xyz = np.array([points[int(i)][1:4] for i in seen[:, 2]], float) @ R.T + t
        projected = np.stack([fx * xyz[:, 0] / xyz[:, 2] + cx, fy * xyz[:, 1] / xyz[:, 2] + cy], -1)
        worst = max(worst, np.abs(projected - seen[:, :2]).max())
        assert all((int(words[0]), place) in tracks[int(i)] for place, i in enumerate(seen[:, 2]))
        observations += len(seen)
    assert worst < 0.001
    assert observations == sum(map(len, tracks.values())) > 1000


def test_colmap_itself_reads_it(exported: Path) -> None:
    pycolmap = pytest.importorskip("pycolmap", reason="pycolmap is not installed: COLMAP's own reader was not tried")
    model = pycolmap.Reconstruction(exported / "colmap" / "sparse" / "0")
    assert model.num_reg_images() == len(KNOWN_KEYFRAMES)
    for image in model.images.values():
        own = box_poses()[int(Path(image.name).stem)]
        np.testing.assert_allclose(image.cam_from_world().matrix(), np.linalg.inv(own)[:3], atol=1e-9)


def test_more_images_leave_out_frames_whose_pose_was_not_measured(known_run: Path, tmp_path: Path) -> None:
    export(known_run, "--to", "nerfstudio", "--images", "99", "--out", tmp_path)
    names = sorted(path.name for path in (tmp_path / "nerfstudio" / "images").iterdir())
    assert names == [f"{i:06d}.png" for i in range(BOX_FRAMES) if i not in (KNOWN_LOST, KNOWN_INTERPOLATED)]


@pytest.mark.parametrize("name", ["mesh.ply", "mesh.obj", "mesh.glb"])
def test_meshes_lie_on_the_walls_in_colour(exported: Path, name: str) -> None:
    # trimesh shows vertex colours of a mesh with a material, as GLB has one, only without the material
    options = {"skip_materials": True} if name.endswith("glb") else {}
    mesh = trimesh.load(exported / name, process=False, force="mesh", **options)
    vertices = np.asarray(mesh.vertices)
    if name.endswith("glb"):
        vertices = vertices @ UP[:3, :3].T  # glTF's y points up
    assert np.median(on_the_walls(vertices)) < 0.01
    assert np.ptp(np.asarray(mesh.visual.vertex_colors)[:, :3], axis=0).min() > 100


def test_points(exported: Path, known_run: Path) -> None:
    cloud = trimesh.load(exported / "points.ply")
    points = np.asarray(cloud.vertices)
    assert np.percentile(on_the_walls(points), 95) < 0.02  # where walls meet, the mean of a voxel lies inside
    assert len(np.unique(np.floor(points / 0.06 + 1e-6), axis=0)) > 0.95 * len(points)  # one a voxel
    near = np.linalg.norm(points - 0, axis=-1) < 10
    wall = np.abs(np.abs(points) - BOX).argmin(-1)
    snapped = np.where(np.eye(3, dtype=bool)[wall], np.sign(points) * BOX, points)[near]
    expected = 0.5 + 0.2 * np.sin(9 * snapped + wall[:, None]) + 0.2 * np.sin(23 * snapped[:, [1, 2, 0]] + 2 * wall[:, None])
    assert np.median(np.abs(np.asarray(cloud.colors)[:, 2::-1] / 255 - expected)) < 0.06


def test_grid(exported: Path) -> None:
    grid = np.load(exported / "grid.npz")
    tsdf, observed, voxel, tr = grid["tsdf"], grid["observed"], float(grid["voxel_size"]), float(grid["truncation"])
    assert (voxel, tr) == (0.06, 0.06)
    assert grid["colour"].shape == (*tsdf.shape, 3)
    points = grid["origin"] + np.stack(np.meshgrid(*map(np.arange, tsdf.shape), indexing="ij"), -1) * voxel
    inside = (np.abs(points) < BOX).all(-1)
    distance = np.where(inside, (BOX - np.abs(points)).min(-1), -1)
    assert observed[inside].mean() > 0.2  # what the camera looked at
    near = observed & inside & (distance < tr)
    assert np.median(np.abs(tsdf[near] * tr - distance[near])) < 0.01
    free = observed & inside & (distance > 2 * tr)
    assert free.sum() > 1000
    assert (tsdf[free] > 0).mean() > 0.99
    assert (tsdf[~observed] == 1).all()
    behind = np.abs(points).max(-1) > BOX.max() + 0.3
    assert not observed[behind].any()


def test_blocks_are_pieces_of_the_grid(exported: Path) -> None:
    grid, blocks = np.load(exported / "grid.npz"), np.load(exported / "blocks.npz")
    for i in range(0, len(blocks["tsdf"]), 5):
        x, y, z = np.round((blocks["origin"][i] - grid["origin"]) / 0.06).astype(int)
        piece = np.s_[x : x + 16, y : y + 16, z : z + 16]
        for name in ("tsdf", "colour", "observed"):
            np.testing.assert_array_equal(grid[name][piece], blocks[name][i])


def shown(mesh: trimesh.Trimesh, T_wc: NDArray[np.float64], camera: Camera) -> NDArray[np.float64]:
    """(H, W, 3) what a renderer shows of a mesh with a texture, as OpenGL samples it; NaN where there is no surface."""
    material = mesh.visual.material
    image = np.asarray((getattr(material, "baseColorTexture", None) or material.image).convert("RGB"), np.float32) / 255
    hits = RayCaster(mesh).cast(T_wc[:3, 3].astype(np.float32), pixel_rays(camera, T_wc))
    weights = np.concatenate([1 - hits.barycentric.sum(-1, keepdims=True), hits.barycentric], -1)
    uv = (np.asarray(mesh.visual.uv)[mesh.faces[hits.face]] * weights[..., None]).sum(1)
    shape = (camera.height, camera.width)
    x, y = uv[:, 0] * image.shape[1] - 0.5, (1 - uv[:, 1]) * image.shape[0] - 0.5
    colour = cv2.remap(image, x.astype(np.float32).reshape(shape), y.astype(np.float32).reshape(shape), cv2.INTER_LINEAR)
    return np.where((hits.face >= 0).reshape(*shape, 1), colour, np.nan)


@pytest.mark.parametrize("texture", ["images", "map"])
def test_textures_show_what_was_recorded(known_run: Path, box_recording: Path, tmp_path: Path, texture: str) -> None:
    export(known_run, "--to", "obj", "glb", "--texture", texture, "--resolution", "0.08", "--up", "camera", "--out", tmp_path)
    camera, pose = read_keyframes(known_run).camera, box_poses()[3]  # no keyframe
    recorded = cv2.imread(str(box_recording / "rgb" / "0003.png"))[..., ::-1] / 255
    errors = {}
    for name in ("mesh.obj", "mesh.glb"):
        mesh = trimesh.load(tmp_path / name, process=False, force="mesh")
        if name.endswith("glb"):
            mesh.apply_transform(UP)
        picture = shown(mesh, pose, camera)
        known = np.isfinite(picture).all(-1)
        assert known.mean() > 0.9
        errors[name] = np.abs(picture - recorded)[known].mean()
    assert max(errors.values()) < {"images": 0.02, "map": 0.08}[texture]
    assert errors["mesh.obj"] == pytest.approx(errors["mesh.glb"], abs=0.002)


def refused(capsys: pytest.CaptureFixture[str], run: Path, *arguments: str | Path) -> str:
    with pytest.raises(SystemExit) as caught:
        export(run, *arguments)
    assert caught.value.code == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    return error


def test_wrong_input_is_one_line(known_run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "expected metres above 0" in refused(capsys, known_run, "--to", "ply", "--resolution", "0", "--out", tmp_path)
    assert "choose obj or glb" in refused(capsys, known_run, "--to", "ply", "--texture", "map", "--out", tmp_path)
    assert "--images 0" in refused(capsys, known_run, "--to", "colmap", "--images", "0", "--out", tmp_path)
    assert "no such folder" in refused(capsys, tmp_path / "none", "--to", "tum")
    assert "or --to blocks" in refused(capsys, known_run, "--to", "grid", "--resolution", "0.001", "--out", tmp_path)
    elsewhere = refused(capsys, known_run, "--to", "nerfstudio", "--recording", tmp_path / "gone", "--out", tmp_path)
    assert "no such file or folder" in elsewhere
    assert "or another camera" in refused(capsys, known_run, "--to", "points", "--recording", "synthetic", "--out", tmp_path)


def test_a_run_without_a_recording_still_gives_mesh_and_poses(known_run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    import shutil

    from idfslam.config import FAST

    alone = shutil.copytree(known_run, tmp_path / "alone")
    write_config(alone, FAST, None)
    export(alone, "--to", "tum", "ply", "--resolution", "0.1")
    assert "no floor was found" in capsys.readouterr().err  # the camera saw two walls
    assert (alone / "export" / "mesh.ply").is_file()
    assert "names no recording" in refused(capsys, alone, "--to", "colmap")
