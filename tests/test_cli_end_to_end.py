"""The commands one after the other, on a recording of 14 frames and on a piece of a generated room."""

import json
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh

from helpers.box_room import BOX_FRAMES, BOX_HEIGHT, BOX_WIDTH
from helpers.visible_files import visible_files
from idfslam.cli import command_line
from idfslam.geometry.trajectory import load_tum
from idfslam.runs import result_folder
from idfslam.runs.evaluate_run import evaluate_folder

pytestmark = pytest.mark.slow


def command(*arguments: str | Path) -> None:
    command_line.main([str(argument) for argument in arguments])


@pytest.fixture(scope="module")
def finished(box_recording: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The result folder of one run; not to be changed."""
    folder = tmp_path_factory.mktemp("results") / "box"
    command("run", box_recording, "--out", folder, "--device", "cpu", "--mesh.resolution", "0.05")
    return folder


def test_run(finished: Path) -> None:
    assert sorted(path.name for path in finished.iterdir() if path.name in result_folder.FILES) == sorted(result_folder.FILES)
    assert len(load_tum(finished / result_folder.TRAJECTORY)) == BOX_FRAMES
    metrics = json.loads((finished / result_folder.METRICS).read_text())
    assert metrics["lost_frames"] == 0
    assert metrics["ate_m"]["rmse"] < 0.05
    mesh = trimesh.load_mesh(finished / result_folder.MESH)
    assert np.ptp(mesh.vertices, axis=0).max() < 5  # the box room is 3.6 m long


def test_two_runs_with_one_seed_are_identical(finished: Path, box_recording: Path, tmp_path: Path) -> None:
    command("run", box_recording, "--out", tmp_path, "--config", finished / result_folder.CONFIG, "--no-report")
    for name in (result_folder.TRAJECTORY, result_folder.KEYFRAMES):
        assert (tmp_path / name).read_bytes() == (finished / name).read_bytes()


def test_selection_and_default_folder(box_recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    selection = ("--start", "2", "--stride", "3", "--frames", "3")
    command("run", box_recording, *selection, "--device", "cpu", "--mesh.resolution", "0.1", "--no-report")
    folder = tmp_path / "results" / "box"
    assert np.allclose(load_tum(folder / result_folder.TRAJECTORY).timestamps, np.array([2, 5, 8]) / 30, atol=1e-6)
    command("eval", folder)
    assert json.loads((folder / "evaluation.json").read_text())["frames"] == 3


def test_eval_prints_a_table(finished: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command("eval", finished)
    printed = capsys.readouterr().out
    assert "ATE" in printed
    assert "evaluation.json" in printed


def test_mesh_at_another_resolution(finished: Path, tmp_path: Path) -> None:
    command("mesh", finished, "--resolution", "0.1", "--out", tmp_path / "coarse.ply")
    coarse, fine = trimesh.load_mesh(tmp_path / "coarse.ply"), trimesh.load_mesh(finished / result_folder.MESH)
    assert 0 < len(coarse.faces) < len(fine.faces)


def test_mesh_of_an_unknown_kind_is_refused(finished: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        command("mesh", finished, "--out", "mesh.xyz")
    assert caught.value.code == 1
    assert "meshes are written as .ply" in capsys.readouterr().err


def test_render_shows_the_room(finished: Path, tmp_path: Path) -> None:
    command("render", finished, "--frames", "0", "7", "--out", tmp_path)
    assert visible_files(tmp_path) == [f"{i:06d}-{kind}.png" for i in (0, 7) for kind in ("colour", "depth")]
    depth = cv2.imread(str(tmp_path / "000000-depth.png"), cv2.IMREAD_UNCHANGED)
    assert depth.shape == (BOX_HEIGHT, BOX_WIDTH)
    assert depth.dtype == np.uint16
    assert 1000 < np.median(depth) < 3500  # [mm] the walls are 1.1 to 2.5 m away


def test_render_of_a_frame_that_is_not_there(finished: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        command("render", finished, "--frames", "99")
    assert caught.value.code == 1
    assert "the trajectory has frames 0 to 13" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("flag", "pictures"),
    [("--report", ["overview.png", "report.html", "scene.html", "pictures"]), ("--no-report", ["overview.png", "views.png"])],
)
def test_demo(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, flag: str, pictures: list[str]) -> None:
    fewer = partial(evaluate_folder, samples=2000)  # of 200,000: most points of so small a mesh's truth are far from it, and take long
    monkeypatch.setattr("idfslam.demo.demo.evaluate_folder", fewer)
    command("demo", "--frames", "5", "--out", tmp_path, "--device", "cpu", "--mesh.resolution", "0.05", flag)
    printed = capsys.readouterr().out
    for name in (*result_folder.FILES, *result_folder.EVALUATION_FILES, *pictures):
        assert (tmp_path / name).exists()
        assert str(tmp_path / name) in printed
    assert (tmp_path / "pictures" / "mesh_1.png").is_file() == (flag == "--report")
    assert json.loads((tmp_path / "evaluation.json").read_text())["mesh"]["protocol"] == "seen"
