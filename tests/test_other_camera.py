"""A recording of another camera and image size is localised in the map of a first one, and extends it."""

import json
import logging
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from helpers.box_room import BOX, BOX_CAMERA, OTHER_CAMERA, box_poses, write_box_recording
from idfslam.cli import command_line
from idfslam.config import FAST
from idfslam.errors import ResultError
from idfslam.geometry.camera import Camera
from idfslam.geometry.trajectory import load_tum
from idfslam.geometry.transforms_json import read_transforms
from idfslam.mapping.saved_map import load_map
from idfslam.runs import result_folder
from idfslam.runs.keyframes_file import read_keyframes
from idfslam.runs.prior_map import load_prior
from idfslam.runs.run_config import RecordingSource, read_config, write_config
from idfslam.runs.runner import run
from idfslam.runs.source import open_source

pytestmark = pytest.mark.slow

TILT = 20.0
CONFIG = replace(FAST, mapper=replace(FAST.mapper, first_iterations=60), refinement=replace(FAST.refinement, updates=4))


def localised(recording: Path, folder: Path, prior: Path | None, *, start: int = 0, frames: int | None = None) -> Path:
    """A run, in the map of another."""
    source = RecordingSource(str(recording), start=start, frames=frames)
    run(open_source(source), CONFIG, folder, source=source, prior=None if prior is None else load_prior(prior))
    return folder


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The same walk through the same room by two cameras: 160 x 120 and 200 x 150."""
    folder = tmp_path_factory.mktemp("cameras")
    return write_box_recording(folder / "small", tilt=TILT), write_box_recording(folder / "large", OTHER_CAMERA, tilt=TILT)


@pytest.fixture(scope="module")
def first(recordings: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Frames 0 to 7 by the small camera."""
    return localised(recordings[0], tmp_path_factory.mktemp("first"), None, frames=8)


@pytest.fixture(scope="module")
def second(recordings: tuple[Path, Path], first: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Frames 4 to 13 by the large camera, in the map of the first."""
    return localised(recordings[1], tmp_path_factory.mktemp("second"), first, start=4)


def errors(folder: Path, start: int) -> NDArray[np.float64]:
    """(N,) distances [m] of a trajectory from the truth in the world of the first run, without alignment."""
    truth = np.linalg.inv(box_poses(TILT)[0]) @ box_poses(TILT)
    found = load_tum(folder / result_folder.TRAJECTORY).poses
    return np.linalg.norm((found - truth[start : start + len(found)])[:, :3, 3], axis=1)


def on_the_walls(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N,) distances [m] to the box of points in the world of the first run."""
    T = box_poses(TILT)[0]
    return np.abs(np.abs(points @ T[:3, :3].T + T[:3, 3]) - BOX).min(-1)


def cameras_of(folder: Path) -> list[Camera]:
    """Those of the map's views."""
    return [view.camera for view in load_map(folder / result_folder.MAP).views]


def test_the_second_lies_in_the_first_ones_world(second: Path) -> None:
    found = errors(second, 4)
    assert len(found) == 10
    assert found.max() < 0.015
    assert found.mean() < 0.008
    metrics = json.loads((second / result_folder.METRICS).read_text())
    assert metrics["lost_frames"] == 0
    assert all((second / name).is_file() for name in result_folder.FILES)


def test_the_mesh_is_the_room(first: Path, second: Path) -> None:
    meshes = [trimesh.load(folder / result_folder.MESH) for folder in (first, second)]
    assert meshes[1].area > 1.02 * meshes[0].area
    distances = on_the_walls(np.asarray(meshes[1].vertices))
    assert np.median(distances) < 0.003
    assert np.percentile(distances, 95) < 0.01


def test_each_view_keeps_its_camera(first: Path, second: Path) -> None:
    small, both = cameras_of(first), cameras_of(second)
    assert {(c.width, c.height) for c in small} == {(80, 60)}
    assert {(c.width, c.height) for c in both} == {(80, 60), (100, 75)}
    assert both[: len(small)] == small  # those of the first run, then those of the second
    for view in load_map(second / result_folder.MAP).views:
        assert view.depth.shape == (view.camera.height, view.camera.width)
        points = np.asarray(np.argwhere(view.depth > 0))[::37]
        z = view.depth[points[:, 0], points[:, 1]]
        local = np.stack(
            [(points[:, 1] - view.camera.cx) / view.camera.fx * z, (points[:, 0] - view.camera.cy) / view.camera.fy * z, z], -1
        )
        assert np.median(on_the_walls(local @ view.T_wc[:3, :3].T + view.T_wc[:3, 3])) < 0.008


def test_each_keyframe_keeps_its_camera(recordings: tuple[Path, Path], second: Path) -> None:
    record = read_keyframes(second)
    assert record.camera == OTHER_CAMERA
    assert record.earlier
    assert {k.camera for k in record.earlier} == {BOX_CAMERA}
    assert {k.source.path for k in record.earlier} == {str(recordings[0])}


@pytest.mark.parametrize(("camera", "start"), [(0, 5), (1, 3)])
def test_a_map_of_two_cameras_is_started_in_with_either(
    recordings: tuple[Path, Path], second: Path, tmp_path: Path, camera: int, start: int
) -> None:
    prior = load_prior(second)
    assert {k.frame.camera for k in prior.keyframes} == {BOX_CAMERA, OTHER_CAMERA}
    localised(recordings[camera], tmp_path, second, start=start)
    assert errors(tmp_path, start).max() < 0.015
    assert json.loads((tmp_path / result_folder.METRICS).read_text())["lost_frames"] == 0
    assert {(c.width, c.height) for c in cameras_of(tmp_path)} == {(80, 60), (100, 75)}
    earlier = read_keyframes(tmp_path).earlier
    assert {(k.source.path, k.camera) for k in earlier} == {(str(recordings[0]), BOX_CAMERA), (str(recordings[1]), OTHER_CAMERA)}


def test_keyframes_without_a_camera_have_that_of_their_recording(second: Path, tmp_path: Path) -> None:
    """As earlier versions wrote them."""
    for name in (result_folder.MAP, result_folder.KEYFRAMES, result_folder.CONFIG):
        (tmp_path / name).write_bytes((second / name).read_bytes())
    values = json.loads((tmp_path / result_folder.KEYFRAMES).read_text())
    for keyframe in values["earlier"]:
        del keyframe["camera"]
    (tmp_path / result_folder.KEYFRAMES).write_text(json.dumps(values))
    found = load_prior(tmp_path).keyframes
    assert [k.record.camera for k in found] == [k.frame.camera for k in found]
    assert {k.frame.camera for k in found} == {BOX_CAMERA, OTHER_CAMERA}


def test_a_recording_that_has_another_camera_now(first: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """What stands where the map's recording was is another: nothing is computed."""
    for name in (result_folder.MAP, result_folder.KEYFRAMES, result_folder.CONFIG):
        (tmp_path / name).write_bytes((first / name).read_bytes())
    config, source = read_config(first)
    assert source is not None
    elsewhere = write_box_recording(tmp_path / "other", OTHER_CAMERA, tilt=TILT)
    write_config(tmp_path, config, replace(source, path=str(elsewhere)))
    with caplog.at_level(logging.WARNING), pytest.raises(ResultError, match="none of its keyframes' images can be read again"):
        load_prior(tmp_path)
    assert "other: has a camera of 200x150" in caplog.text


@pytest.fixture(scope="module")
def exported(second: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("exported")
    formats = ("nerfstudio", "colmap", "points", "ply", "obj", "grid", "blocks")
    command_line.main(
        ["export", str(second), "--to", *formats, "--texture", "images", "--resolution", "0.06", "--out", str(out), "--up", "camera"]
    )
    return out


def test_nerfstudio_has_a_camera_for_each_frame(exported: Path, second: Path) -> None:
    record, folder = read_keyframes(second), exported / "nerfstudio"
    values = json.loads((folder / "transforms.json").read_text())
    names = [f"earlier_{i:06d}.png" for i in range(len(record.earlier))] + [f"{i:06d}.png" for i in record.indices]
    assert [frame["file_path"] for frame in values["frames"]] == [f"images/{name}" for name in names]
    assert "fl_x" not in values
    for frame in values["frames"]:
        depth = cv2.imread(str(folder / frame["depth_file_path"]), cv2.IMREAD_UNCHANGED)
        assert depth.shape == (frame["h"], frame["w"])
        u, v = 20, 90
        z = depth[v, u] / 1000
        x, y = (u + 0.5 - frame["cx"]) / frame["fl_x"] * z, (v + 0.5 - frame["cy"]) / frame["fl_y"] * z
        assert on_the_walls((np.array(frame["transform_matrix"]) @ [x, -y, -z, 1])[None, :3])[0] < 0.012
    poses, camera = read_transforms(folder / "transforms.json")
    assert len(poses) == len(names)
    assert camera is None


def test_colmap_has_two_cameras(exported: Path, second: Path) -> None:
    record, folder = read_keyframes(second), exported / "colmap" / "sparse" / "0"
    lines = {name: (folder / f"{name}.txt").read_text().splitlines()[1:] for name in ("cameras", "images", "points3D")}
    cameras = {words[0]: words for words in (line.split() for line in lines["cameras"])}
    assert cameras["1"][1:] == ["PINHOLE", "160", "120", "140", "140", "80", "60"]
    assert cameras["2"][1:] == ["PINHOLE", "200", "150", "160", "165", "97.5", "76.5"]
    heads = [line.split() for line in lines["images"][::2]]
    assert [head[8] for head in heads] == ["1"] * len(record.earlier) + ["2"] * len(record.indices)
    points = {words[0]: np.array(words[1:4], float) for words in (line.split() for line in lines["points3D"])}
    for head, body in zip(heads, lines["images"][1::2]):
        seen = np.array(body.split(), float).reshape(-1, 3)
        width, height = map(float, cameras[head[8]][2:4])
        assert len(seen) > 100
        assert (seen[:, :2] >= 0).all()
        assert (seen[:, 0] <= width).all()
        assert (seen[:, 1] <= height).all()
        assert np.median(on_the_walls(np.array([points[f"{int(i)}"] for i in seen[:, 2]]))) < 0.012


def test_other_exports_show_the_room(exported: Path) -> None:
    cloud = np.asarray(trimesh.load(exported / "points.ply").vertices)
    assert np.percentile(on_the_walls(cloud), 90) < 0.03
    assert np.median(on_the_walls(np.asarray(trimesh.load(exported / "mesh.ply").vertices))) < 0.01
    grid = np.load(exported / "grid.npz")
    assert grid["observed"].mean() > 0.1


def test_mesh_pictures_and_report(second: Path, tmp_path: Path) -> None:
    command_line.main(["mesh", str(second), "--resolution", "0.05", "--up", "camera", "--out", str(tmp_path / "mesh.ply")])
    assert np.median(on_the_walls(np.asarray(trimesh.load(tmp_path / "mesh.ply").vertices))) < 0.01
    command_line.main(["render", str(second), "--frames", "0", "9", "--out", str(tmp_path / "views")])
    for i in (0, 9):
        assert cv2.imread(str(tmp_path / "views" / f"{i:06d}-colour.png")).shape == (150, 200, 3)
    copy = shutil.copytree(second, tmp_path / "copy")
    command_line.main(["report", str(copy)])
    assert "200 x 150 px" in (copy / result_folder.REPORT).read_text()
    command_line.main(["eval", str(copy)])
    assert json.loads((copy / "evaluation.json").read_text())["ate_m"]["rmse"] < 0.01
