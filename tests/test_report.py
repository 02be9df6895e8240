"""The report of a run: what the page holds, that it needs nothing else, and what a browser makes of it."""

import html.parser
import re
import shutil
import subprocess
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh

from helpers.box_room import BOX, box_poses
from idfslam.cli import command_line
from idfslam.config import FAST
from idfslam.errors import ResultError
from idfslam.geometry.level import from_above, level
from idfslam.geometry.trajectory import TrajectoryError
from idfslam.report.writing import write_report
from idfslam.runs import result_folder
from idfslam.runs.run_config import RecordingSource, write_config
from idfslam.storage import atomic_files
from idfslam.storage.ledger import Ledger

VOID = {"meta", "img", "br", "link", "hr"}
PICTURES = {
    "trajectory_top", "trajectory_side", "trajectory_front", "error", "frames", "stages", "losses", "mesh_1", "inside_1",
    "inside_4", "slice_1", "slice_3", "view_1_colour_recorded", "view_4_depth_error",
}  # fmt: skip
BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


class Page(html.parser.HTMLParser):
    """Elements counted; complains of those that are not closed in order."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.counts: dict[str, int] = {}
        self.sources: list[str] = []
        self.ids: list[str] = []
        self.feed(text)
        assert not self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.counts[tag] = self.counts.get(tag, 0) + 1
        self.sources += [value or "" for name, value in attrs if name in ("src", "href")]
        self.ids += [value or "" for name, value in attrs if name == "id"]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


@pytest.fixture(scope="module")
def reported(known_run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = shutil.copytree(known_run, tmp_path_factory.mktemp("report") / "known")
    command_line.main(["report", str(folder)])
    return folder


@pytest.mark.slow
def test_the_page_is_whole_and_needs_nothing_else(reported: Path) -> None:
    text = (reported / result_folder.REPORT).read_text()
    page = Page(text)
    assert page.counts["svg"] == 10  # three of the trajectory, error, frames, stages, losses, three slices
    outside = len(list((reported / result_folder.PICTURES).glob("mesh_*.png")))
    assert 1 <= outside <= 4  # sides that show the backs of the walls are left out
    assert page.counts["img"] == outside + 4 + 4 * 5  # and inside, frames
    assert all(source.startswith(("data:image/", "#")) or source == "scene.html" for source in page.sources)  # which lies beside it
    assert (reported / result_folder.SCENE).is_file()
    assert not re.search(r"https?://|url\((?!#)|@import|<script", text)
    assert len(page.ids) == len(set(page.ids))
    assert {source[1:] for source in page.sources if source.startswith("#")} <= set(page.ids)
    assert set(re.findall(r"url\(#([\w-]+)\)", text)) <= set(page.ids)
    assert 'content="width=device-width' in text
    assert "prefers-color-scheme: dark" in text


@pytest.mark.slow
def test_the_page_tells_the_figures(reported: Path) -> None:
    text = re.sub(r"<[^>]+>", " ", (reported / result_folder.REPORT).read_text())
    text = re.sub(r"\s+", " ", text)
    for figure in ("frames 14 ", "speed 10.0 frames/s", "ATE RMSE 0.00 cm", "lost frames 1 ", "keyframes 3 ", "memory 512 MiB"):
        assert figure in text
    assert "Frame 4: no image confirmed a pose; the last motion was carried on" in text and "1 and 0 degenerate, 0 doubtful" in text
    assert "align 40.00 60 %" in text  # of 66.5 ms
    assert "table_log2" in text
    assert "torch" in text


@pytest.mark.slow
def test_pictures_are_files_too(reported: Path) -> None:
    found = {path.stem for path in (reported / result_folder.PICTURES).glob("*.png")}
    assert found >= PICTURES
    assert 10 + 25 <= len(found) <= 10 + 28
    for name in found:
        assert cv2.imread(str(reported / result_folder.PICTURES / f"{name}.png")).std() > 3  # none is blank


@pytest.mark.slow
def test_depth_of_the_map_is_the_recorded_one(reported: Path) -> None:
    errors = re.findall(r"median depth error ([\d.]+) cm", (reported / result_folder.REPORT).read_text())
    assert len(errors) == 4
    assert max(map(float, errors)) < 2


def test_without_recording_map_and_log(known_run: Path, tmp_path: Path) -> None:
    folder = tmp_path / "poor"
    folder.mkdir()
    for name in (result_folder.TRAJECTORY, result_folder.KEYFRAMES):
        shutil.copy(known_run / name, folder)
    write_config(folder, FAST, RecordingSource(str(tmp_path / "gone")))
    atomic_files.write_json(folder / result_folder.METRICS, {"submaps": 3})
    (folder / result_folder.PICTURES).mkdir()
    (folder / result_folder.PICTURES / "mesh_1.png").write_bytes(b"of an earlier report")
    Ledger(folder).record([f"{result_folder.PICTURES}/mesh_1.png"])
    (folder / result_folder.PICTURES / "mine.png").write_bytes(b"mine")
    write_report(folder)
    text = (folder / result_folder.REPORT).read_text()
    page = Page(text)
    assert page.counts["svg"] == 3
    assert "no such file or folder" in text
    assert "has no mesh.ply" in text
    assert re.search(r"submaps apart\W.*?\b2\b", text, re.DOTALL)
    assert {path.stem for path in (folder / result_folder.PICTURES).iterdir()} == {
        "trajectory_top",
        "trajectory_side",
        "trajectory_front",
        "mine",
    }


@pytest.mark.slow
@pytest.mark.parametrize("name", [result_folder.REPORT, "pictures/mesh_1.png"])
def test_what_somebody_else_put_in_the_reports_place_stays(reported: Path, tmp_path: Path, name: str) -> None:
    folder = shutil.copytree(reported, tmp_path / "again")
    (folder / name).write_bytes(b"mine")
    with pytest.raises(ResultError, match=f"{name}: was changed since idf-slam wrote it, so it is not replaced; move it away"):
        write_report(folder)
    assert (folder / name).read_bytes() == b"mine"


@pytest.mark.slow
def test_a_report_that_fails_leaves_the_earlier_one(reported: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(reported, tmp_path / "again")
    (folder / result_folder.TRAJECTORY).write_text("no trajectory")
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    with pytest.raises(TrajectoryError, match=r"trajectory\.txt:1: 2 values"):
        write_report(folder)
    assert {path: path.read_bytes() for path in before} == before


def test_no_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        command_line.main(["report", str(tmp_path / "none")])
    assert caught.value.code == 1
    assert "no such folder" in capsys.readouterr().err


def test_names_cannot_become_markup(known_run: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(known_run, tmp_path / "<b>bold")
    (folder / result_folder.MESH).unlink()  # the pictures have no names in them, and take time
    (folder / result_folder.MAP).unlink()
    write_config(folder, FAST, RecordingSource("<i>gone"))
    write_report(folder)
    text = (folder / result_folder.REPORT).read_text()
    assert "&lt;b&gt;bold" in text
    assert "<i>gone" not in text


def test_the_room_is_set_upright() -> None:
    """A box, its walls 30 degrees from the camera: z is up, x and y lie along the walls."""
    mesh = trimesh.creation.box(2 * BOX)
    mesh.invert()
    found = level(mesh, box_poses())
    assert found.by_gravity
    R_lw = found.R_lw
    np.testing.assert_allclose(R_lw @ R_lw.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(R_lw[2], [0, -1, 0], atol=1e-9)
    np.testing.assert_allclose(np.abs(R_lw).max(1), 1, atol=1e-9)  # the camera's 30 degrees are gone
    T = from_above(R_lw, np.zeros(3), 5.0)
    np.testing.assert_allclose(T[:3, 3], [0, -5, 0], atol=1e-9)
    np.testing.assert_allclose(T[:3, 2], [0, 1, 0], atol=1e-9)  # it looks down


@pytest.mark.slow
@pytest.mark.skipif(BROWSER is None, reason="no Chromium is installed: the page was not opened in a browser")
@pytest.mark.parametrize("width", [1200, 500])
def test_a_browser_shows_it(reported: Path, tmp_path: Path, width: int) -> None:
    """What it draws fills the window, has the room's colours, and nothing is wider than a phone."""
    assert BROWSER is not None
    picture, address = tmp_path / "page.png", (reported / result_folder.REPORT).absolute().as_uri()
    flags = ("--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", f"--user-data-dir={tmp_path / 'profile'}")
    run = [BROWSER, *flags, f"--window-size={width},3000", f"--screenshot={picture}", address]
    subprocess.run(run, check=True, capture_output=True, timeout=300)
    image = cv2.imread(str(picture))
    assert image.shape == (3000, width, 3)
    background = image[5, 5]
    drawn = (np.abs(image.astype(int) - background).max(-1) > 40).reshape(30, 100, width)
    assert (drawn.mean((1, 2)) > 0.002).mean() > 0.9  # hardly any empty strip: text, charts and pictures down the page
    assert not drawn[:, :, -4:].any()  # the margin on the right is free
    saturation = cv2.cvtColor(image, cv2.COLOR_BGR2HSV)[..., 1]
    assert (saturation > 80).mean() > 0.01  # the pictures are in colour
