"""scene.html: that it is whole and needs nothing else, shows the run's path, keyframes and surface, and what a browser draws."""

import base64
import json
import re
import shutil
import struct
import subprocess
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from helpers.box_room import BOX, BOX_CAMERA, BOX_FOCAL, BOX_FRAMES, BOX_HEIGHT, BOX_WIDTH
from helpers.known_run import KNOWN_INTERPOLATED, KNOWN_KEYFRAMES, KNOWN_LOST
from idfslam.cli import command_line
from idfslam.datasets import open_recording
from idfslam.export.compact_glb import compact_glb
from idfslam.export.mesh_files import linear
from idfslam.pictures.scraps import without_scraps
from idfslam.runs import result_folder
from idfslam.runs.finished_run import FinishedRun
from idfslam.views.encoded_view import encode
from idfslam.views.image_archive import archive_of, save_archive

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
_SOFTWARE = ("--headless=new", "--no-sandbox", "--hide-scrollbars", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")


@pytest.fixture(scope="module")
def shown(known_run: Path, box_recording: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the known run, an archive of five of its frames, and its page."""
    folder = shutil.copytree(known_run, tmp_path_factory.mktemp("page") / "known")
    recording, poses = open_recording(box_recording), FinishedRun(folder).trajectory.poses
    kept = range(0, BOX_FRAMES, 3)
    save_archive(folder / result_folder.ARCHIVE, archive_of([encode(recording[i], 0.5) for i in kept], BOX_CAMERA, poses[list(kept)]))
    command_line.main(["export", str(folder), "--to", "page", "--resolution", "0.08", "--out", str(folder)])
    return folder


@pytest.fixture(scope="module")
def text(shown: Path) -> str:
    return (shown / result_folder.SCENE).read_text(encoding="utf-8")


def script(text: str, name: str) -> str:
    found = re.search(rf'<script type="[\w/-]+" id="{name}">(.*?)</script>', text, re.DOTALL)
    assert found
    return found[1]


def chunks(glb: bytes) -> tuple[dict[str, Any], bytes]:
    """The JSON and the binary part of a GLB file, whose lengths fit."""
    magic, version, length, json_length, kind = struct.unpack_from("<4sIIII", glb)
    assert (magic, version, length, kind) == (b"glTF", 2, len(glb), 0x4E4F534A)
    binary_length, kind = struct.unpack_from("<II", glb, 20 + json_length)
    assert (kind, 28 + json_length + binary_length) == (0x004E4942, length)
    return json.loads(glb[20 : 20 + json_length]), glb[28 + json_length :]


def attribute(tree: dict[str, Any], data: bytes, name: str, kind: str) -> NDArray[Any]:
    accessor = tree["accessors"][tree["meshes"][0]["primitives"][0]["attributes"][name]]
    view, components = tree["bufferViews"][accessor["bufferView"]], int(accessor["type"][-1])
    item = np.dtype((kind, components))
    return np.ndarray((accessor["count"], components), kind, data, view["byteOffset"], (view["byteStride"], item.base.itemsize))


def test_the_page_needs_nothing_else(text: str) -> None:
    assert len(text) < 30e6
    assert set(re.findall(r"https?://[\w./-]*", text)) == {"http://www.w3.org/1999/xhtml"}  # a name space: nothing is fetched
    assert "default-src 'none'" in text
    assert not re.search(r"<link|@import|<script[^>]*src=|<img[^>]*src=", text)
    assert text.count("<script") == text.count("</script>") == 4


def test_it_shows_the_path_and_the_keyframes_of_the_run(text: str, shown: Path) -> None:
    run, content = FinishedRun(shown), json.loads(script(text, "run"))
    assert content["frames"] == list(range(BOX_FRAMES))
    names = [content["statuses"][k]["name"] for k in content["status"]]
    assert names == [{KNOWN_LOST: "lost", KNOWN_INTERPOLATED: "interpolated"}.get(i, "ok") for i in range(BOX_FRAMES)]
    assert tuple(keyframe["frame"] for keyframe in content["keyframes"]) == KNOWN_KEYFRAMES
    assert content["camera"]["fy"] == BOX_FOCAL
    path = np.array(content["path"])
    steps, of_run = (np.linalg.norm(np.diff(places, axis=0), axis=1) for places in (path[:, :3], run.trajectory.positions))
    np.testing.assert_allclose(steps, of_run, atol=3e-4)
    np.testing.assert_allclose(np.linalg.norm(path[:, 3:], axis=1), 1, atol=1e-4)
    for keyframe in content["keyframes"]:
        np.testing.assert_allclose(keyframe["pose"], path[keyframe["frame"]], atol=1e-4)
        data = base64.b64decode(keyframe["picture"].removeprefix("data:image/webp;base64,"))
        picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
        assert picture.shape == (BOX_HEIGHT, BOX_WIDTH, 3)
        assert np.abs(picture[..., ::-1] / 255 - run.recording[keyframe["frame"]].colour).mean() < 0.03


def test_its_mesh_is_a_textured_glb_of_the_room(text: str) -> None:
    tree, data = chunks(base64.b64decode(script(text, "mesh"), validate=True))
    points = attribute(tree, data, "POSITION", "<f4")
    normals = attribute(tree, data, "NORMAL", "i1") / 127
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=0.02)
    uv = attribute(tree, data, "TEXCOORD_0", "<u2") / 65535
    assert ((uv > 0) & (uv < 1)).all()
    view = tree["bufferViews"][tree["images"][0]["bufferView"]]
    image = cv2.imdecode(np.frombuffer(data, np.uint8, view["byteLength"], view["byteOffset"]), cv2.IMREAD_COLOR)
    assert image is not None
    off_wall = np.abs(np.abs(points) - BOX).min(1)  # [m] the known run's world lies level, with y up in the page
    assert np.percentile(off_wall, 95) < 0.05
    texels = len(points) / 3 * 28  # of the smallest squares
    assert image.shape[0] * image.shape[1] > texels


def test_a_mesh_with_vertex_colours_is_a_glb_that_trimesh_reads() -> None:
    box = trimesh.creation.box((1.0, 2.0, 3.0))
    colours = np.arange(32, dtype=np.uint8).reshape(8, 4) * 8
    colours[:, 3] = 255
    box.visual.vertex_colors = colours
    glb = compact_glb(box)
    tree, data = chunks(glb)
    np.testing.assert_array_equal(attribute(tree, data, "COLOR_0", "u1"), linear(colours))
    read = trimesh.load(trimesh.util.wrap_as_stream(glb), file_type="glb", process=False, force="mesh")
    np.testing.assert_allclose(read.vertices, box.vertices, atol=1e-6)
    np.testing.assert_array_equal(read.faces, box.faces)


def test_scraps_are_no_part_of_the_page() -> None:
    room = trimesh.creation.box((4.0, 3.0, 5.0))
    near, scrap = trimesh.creation.box((0.3, 0.3, 0.3)), trimesh.creation.box((0.05, 0.05, 0.05))
    left = without_scraps(trimesh.util.concatenate([room, scrap, near]))
    assert len(left.faces) == 24
    assert left.area == pytest.approx(room.area + near.area)


def test_a_run_without_images_shows_the_colours_of_its_mesh(known_run: Path, tmp_path: Path) -> None:
    command_line.main(["export", str(known_run), "--to", "page", "--resolution", "0.1", "--out", str(tmp_path)])
    tree, _ = chunks(base64.b64decode(script((tmp_path / result_folder.SCENE).read_text(encoding="utf-8"), "mesh")))
    assert "COLOR_0" in tree["meshes"][0]["primitives"][0]["attributes"]
    assert "images" not in tree


@pytest.mark.slow
@pytest.mark.skipif(BROWSER is None, reason="no Chromium is installed: the page was not opened in a browser")
@pytest.mark.parametrize("address", ["", "view=above", "keyframe=1", "look=shape"])
def test_a_browser_shows_the_scene(shown: Path, tmp_path: Path, address: str) -> None:
    """Most of the window is surface from inside; from outside there is surface in the middle, in colour unless only shape is shown."""
    assert BROWSER is not None
    picture, page = tmp_path / "page.png", (shown / result_folder.SCENE).absolute().as_uri()
    flags = (*_SOFTWARE, f"--user-data-dir={tmp_path / 'profile'}", "--window-size=900,600", "--virtual-time-budget=20000")
    subprocess.run([BROWSER, *flags, f"--screenshot={picture}", f"{page}#{address}"], check=True, capture_output=True, timeout=300)
    image = cv2.imread(str(picture))
    middle = image[180:420, 300:600].astype(int)
    surface = np.abs(middle - image[590, 4].astype(int)).max(-1) > 25
    saturation = cv2.cvtColor(image, cv2.COLOR_BGR2HSV)[180:420, 300:600, 1]
    least = {"view=above": 0.05, "keyframe=1": 0.95}.get(address, 0.4)  # the known run saw hardly any floor
    assert surface.mean() > least
    assert (saturation[surface].mean() > 60) == (address != "look=shape")
