"""Exports and what is there already; frames that were not measured; resolutions that need too much memory."""

import json
import logging
import shutil
from pathlib import Path

import numpy as np
import pytest

from helpers.box_room import BOX_FRAMES, box_poses
from helpers.known_run import KNOWN_INTERPOLATED, KNOWN_KEYFRAMES, KNOWN_LOST
from idfslam.cli import command_line
from idfslam.datasets.poses.pose_file import read_pose_file
from idfslam.export import memory_need
from idfslam.geometry.trajectory import load_tum
from idfslam.mapping.saved_map import load_map
from idfslam.runs import result_folder

NOT_MEASURED = (KNOWN_LOST, KNOWN_INTERPOLATED)
MEASURED = [i for i in range(BOX_FRAMES) if i not in NOT_MEASURED]


def export(run: Path, *arguments: str | Path) -> None:
    command_line.main(["export", str(run), *map(str, arguments), "--up", "camera"])


def refused(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> str:
    capsys.readouterr()
    with pytest.raises(SystemExit) as caught:
        command_line.main([*map(str, arguments)])
    assert caught.value.code == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    return error


def test_files_of_the_user_are_not_replaced(known_run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "mesh.ply").write_text("mine")
    error = refused(capsys, "export", known_run, "--to", "tum", "ply", "--out", tmp_path)
    assert (
        "mesh.ply: was not written by idf-slam, so it is not replaced; choose another folder with --out, or replace it with --overwrite"
        in error
    )
    assert [path.name for path in tmp_path.iterdir()] == ["mesh.ply"]  # nothing was begun
    assert (tmp_path / "mesh.ply").read_text() == "mine"
    export(known_run, "--to", "tum", "--out", tmp_path)
    export(known_run, "--to", "tum", "--out", tmp_path)  # its own
    assert (tmp_path / "mesh.ply").read_text() == "mine"
    (tmp_path / "tum.txt").write_text("edited")
    assert "tum.txt: was changed since idf-slam wrote it" in refused(capsys, "export", known_run, "--to", "tum", "--out", tmp_path)
    assert (tmp_path / "tum.txt").read_text() == "edited"
    export(known_run, "--to", "tum", "--out", tmp_path, "--overwrite")
    assert len(load_tum(tmp_path / "tum.txt")) == BOX_FRAMES


def test_folders_of_the_user_are_not_written_into(known_run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    export(known_run, "--to", "nerfstudio", "--out", tmp_path)
    (tmp_path / "nerfstudio" / "outputs").mkdir()
    (tmp_path / "nerfstudio" / "outputs" / "model").write_text("mine")  # beside what the export writes
    export(known_run, "--to", "nerfstudio", "--out", tmp_path)
    (tmp_path / "nerfstudio" / "images" / "mine.png").write_text("mine")
    assert "mine.png: was not written by idf-slam" in refused(capsys, "export", known_run, "--to", "nerfstudio", "--out", tmp_path)
    (tmp_path / "colmap" / "images").mkdir(parents=True)
    (tmp_path / "colmap" / "images" / "000000.png").write_text("mine")
    assert "000000.png: was not written by idf-slam" in refused(capsys, "export", known_run, "--to", "colmap", "--out", tmp_path)
    assert (tmp_path / "colmap" / "images" / "000000.png").read_text() == "mine"


@pytest.mark.parametrize("text", ["{", "[]", '{"exports": {"ply": 3}}'])
def test_a_transform_json_of_another_program_is_left_alone(
    known_run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str
) -> None:
    (tmp_path / "transform.json").write_text(text)
    assert "transform.json: was not written by idf-slam" in refused(capsys, "export", known_run, "--to", "tum", "--out", tmp_path)
    assert (tmp_path / "transform.json").read_text() == text
    export(known_run, "--to", "tum", "--out", tmp_path, "--overwrite")
    assert list(json.loads((tmp_path / "transform.json").read_text())["exports"]) == ["tum"]


def test_the_mesh_of_the_run_is_not_replaced_by_an_export(known_run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = shutil.copytree(known_run, tmp_path / "run")
    before = (run / result_folder.MESH).read_bytes()
    assert "its mesh.ply would be replaced" in refused(capsys, "export", run, "--to", "ply", "--out", run, "--overwrite")
    assert (run / result_folder.MESH).read_bytes() == before
    export(run, "--to", "tum", "--out", run)


def test_a_mesh_of_the_run_that_was_changed_is_not_replaced(known_run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = shutil.copytree(known_run, tmp_path / "run")
    command_line.main(["mesh", str(run), "--resolution", "0.1"])
    command_line.main(["mesh", str(run), "--resolution", "0.08"])  # its own
    (run / result_folder.MESH).write_text("edited")
    assert "mesh.ply: was changed since idf-slam wrote it" in refused(capsys, "mesh", run)
    assert (run / result_folder.MESH).read_text() == "edited"


def test_the_record_tells_the_axes_of_each_format(known_run: Path, tmp_path: Path) -> None:
    command_line.main(["export", str(known_run), "--to", "tum", "--up", "y", "--out", str(tmp_path)])
    export(known_run, "--to", "kitti", "--out", tmp_path)
    record = json.loads((tmp_path / "transform.json").read_text())
    assert (record["up"], record["exports"]["tum"]["up"], record["exports"]["kitti"]["up"]) == ("camera", "y", "camera")
    T_ew = np.array(record["exports"]["tum"]["T_export_world"])
    np.testing.assert_allclose(load_tum(tmp_path / "tum.txt").poses, T_ew @ box_poses(), atol=1e-8)


def test_lost_frames_are_marked(known_run: Path, tmp_path: Path) -> None:
    export(known_run, "--to", "tum", "kitti", "--out", tmp_path)
    lines = (tmp_path / "tum.txt").read_text().splitlines()
    assert len(load_tum(tmp_path / "tum.txt")) == len(read_pose_file(tmp_path / "kitti.txt").T_wc) == BOX_FRAMES
    remarks = {lines[i + 1].split()[0]: line for i, line in enumerate(lines[1:-1], 1) if line.startswith("#")}
    assert remarks == {
        f"{KNOWN_LOST / 30:.6f}": "# lost: the next pose was not measured",
        f"{KNOWN_INTERPOLATED / 30:.6f}": "# interpolated: the next pose was not measured",
    }
    assert (tmp_path / "lost.txt").read_text().splitlines() == [
        "# frame timestamp status",
        f"{KNOWN_LOST} {KNOWN_LOST / 30:.6f} lost",
        f"{KNOWN_INTERPOLATED} {KNOWN_INTERPOLATED / 30:.6f} interpolated",
    ]


def test_evo_passes_over_the_remarks(known_run: Path, tmp_path: Path) -> None:
    evo = pytest.importorskip("evo.tools.file_interface", reason="evo is not installed")
    export(known_run, "--to", "tum", "kitti", "--out", tmp_path)
    for path in (
        evo.read_tum_trajectory_file(tmp_path / "tum.txt"),
        evo.read_kitti_poses_file(tmp_path / "kitti.txt"),
    ):
        np.testing.assert_allclose(np.array(path.poses_se3), box_poses(), atol=1e-8)


def test_lost_frames_are_dropped(known_run: Path, tmp_path: Path) -> None:
    arguments = ("--to", "tum", "kitti", "nerfstudio", "colmap", "--images", "99", "--lost", "drop", "--out", tmp_path)
    export(known_run, *arguments)
    np.testing.assert_allclose(load_tum(tmp_path / "tum.txt").poses, box_poses()[MEASURED], atol=1e-8)
    np.testing.assert_allclose(read_pose_file(tmp_path / "kitti.txt").T_wc, box_poses()[MEASURED], atol=1e-8)
    np.testing.assert_allclose(np.loadtxt(tmp_path / "kitti_times.txt"), np.array(MEASURED) / 30, atol=1e-6)
    for name in ("nerfstudio", "colmap"):
        assert sorted(path.name for path in (tmp_path / name / "images").iterdir()) == [f"{i:06d}.png" for i in MEASURED]
    assert not (tmp_path / "colmap" / "lost.txt").exists()


def test_lost_frames_are_kept_as_images_where_that_is_asked_for(known_run: Path, tmp_path: Path) -> None:
    export(known_run, "--to", "nerfstudio", "colmap", "--images", "99", "--lost", "keep", "--out", tmp_path)
    frames = json.loads((tmp_path / "nerfstudio" / "transforms.json").read_text())["frames"]
    assert len(frames) == BOX_FRAMES
    assert [frame["status"] for frame in frames if frame["status"] != "ok"] == ["lost", "interpolated"]
    assert (tmp_path / "colmap" / "lost.txt").read_text() == "# image status\n000004.png lost\n000005.png interpolated\n"


def test_a_keyframe_that_was_not_measured_is_no_image(known_run: Path, tmp_path: Path) -> None:
    run = shutil.copytree(known_run, tmp_path / "run")
    log = (run / result_folder.FRAMES).read_text().splitlines()
    log[1] = log[1].replace(",ok,", ",lost,")  # frame 0, a keyframe
    (run / result_folder.FRAMES).write_text("\n".join(log) + "\n")
    export(run, "--to", "nerfstudio", "--out", tmp_path / "out")
    names = [path.name for path in (tmp_path / "out" / "nerfstudio" / "images").iterdir()]
    assert sorted(names) == [f"{i:06d}.png" for i in KNOWN_KEYFRAMES[1:]]


@pytest.mark.parametrize("command", [["mesh"], ["export", "--to", "ply"]])
def test_a_resolution_without_a_surface_is_refused(
    known_run: Path, tmp_path: Path, command: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    error = refused(capsys, command[0], known_run, *command[1:], "--resolution", "1000", "--out", tmp_path / "mesh.ply")
    assert error.endswith("its map has no surface in cells of 1000.0 m; choose a smaller --resolution\n")


def test_an_export_of_nothing_is_refused(known_run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    error = refused(capsys, "export", known_run, "--to", "--out", tmp_path)
    formats = "tum, kitti, nerfstudio, colmap, ply, obj, glb, points, splats, page, masks, grid, blocks"
    assert error == f"error: --to: expected at least one of {formats}\n"


@pytest.mark.parametrize("command", [("export", "--to", "ply"), ("export", "--to", "blocks"), ("mesh",)])
def test_a_resolution_that_needs_too_much_memory_is_refused(
    known_run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], command: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(memory_need, "memory", lambda: (16 * 10**9, 8 * 10**9))
    name, *options = command
    target = tmp_path / "mesh.ply" if name == "mesh" else tmp_path
    error = refused(capsys, name, known_run, *options, "--resolution", "0.0001", "--out", target)
    assert "--resolution 0.0001: the " in error
    assert "GB of memory, 8 GB are free; choose 0.0" in error


def test_the_estimate(monkeypatch: pytest.MonkeyPatch) -> None:
    """100 m2 at 1 mm: 3 x 10^8 triangles of 650 bytes."""
    monkeypatch.setattr(memory_need, "memory", lambda: (128 * 10**9, 20 * 10**9))
    with pytest.raises(Exception, match=r"300 million triangles and need about 195 GB of memory, 20 GB are free; choose 0\.004"):
        memory_need.check_mesh(100.0, 0.001)
    memory_need.check_mesh(100.0, 0.004)


def test_the_triangles_are_as_many_as_estimated(known_run: Path) -> None:
    mesh = load_map(known_run / result_folder.MAP).mesh(0.03)
    assert len(mesh.faces) * 0.03**2 / mesh.area == pytest.approx(3.0, rel=0.25)


def test_a_mesh_finer_than_the_map_is_told(known_run: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    saved = load_map(known_run / result_folder.MAP)
    assert memory_need.finest_cells(saved) == 0.04
    with caplog.at_level(logging.INFO):
        memory_need.log_finest_cells(saved, 0.02)
        assert not caplog.messages
        memory_need.log_finest_cells(saved, 0.01)
    assert caplog.messages == [
        "the finest cells of the map have 4 cm: a mesh in cells of 1 cm has more vertices than one of 2 cm, but no more detail"
    ]
