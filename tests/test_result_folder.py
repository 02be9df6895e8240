"""The result folder: what is not the run's own stays, results are replaced only by complete ones, and a folder in use is locked."""

import errno
import hashlib
import itertools
import json
import multiprocessing
import os
from pathlib import Path
from typing import Any

import pytest

from helpers.box_room import BOX_FRAMES
from helpers.nearly_right_slam import DivergingSlam, InterruptedSlam, NearlyRightSlam, run_known
from helpers.visible_files import visible_files
from idfslam.cli import command_line
from idfslam.config import FAST
from idfslam.errors import ResultError
from idfslam.geometry.trajectory import load_tum
from idfslam.runs import result_folder
from idfslam.runs.evaluate_run import evaluate_folder
from idfslam.runs.run_config import RecordingSource
from idfslam.runs.run_folder import RunFolder, check_usable, claimed, config_folder, folder_for, is_unfinished
from idfslam.runs.runner import run
from idfslam.runs.source import open_source
from idfslam.storage import output_folder
from idfslam.storage.ledger import LEDGER, SCHEMA, Ledger


def content(folder: Path) -> dict[str, str]:
    """The files of a folder, hidden ones too, and the SHA-256 of each."""
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in folder.rglob("*") if path.is_file()}


def refused(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """Runs a command that ends with status 1. Returns the one line that it prints."""
    with pytest.raises(SystemExit) as caught:
        command_line.main([str(argument) for argument in arguments])
    assert caught.value.code == 1
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1, lines
    return lines[0]


# folders that a run does not touch


@pytest.mark.parametrize("name", ["report.html", "config.yaml", "mesh.ply", "notes.txt", ".hidden", "checkpoint.safetensors"])
def test_a_folder_of_somebody_else_is_refused_untouched(
    box_recording: Path, tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / name).write_text("mine")
    (tmp_path / "pictures").mkdir()
    (tmp_path / "pictures" / "mesh_1.png").write_text("mine")
    before = content(tmp_path)
    for flags in ([], ["--overwrite"]):
        line = refused(capsys, "run", box_recording, "--out", tmp_path, *flags)
        assert line.startswith(f"error: {tmp_path}: is not empty (")
        assert line.endswith("...) and holds no results; choose a new folder with --out")
    assert content(tmp_path) == before


@pytest.mark.parametrize("out", [".", "../here", "new/../../here", "../link"])
def test_the_current_folder_is_refused_untouched(
    box_recording: Path, tmp_path: Path, out: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    here = tmp_path / "here"
    here.mkdir()
    (here / "config.yaml").write_text("seed: 3")
    (tmp_path / "link").symlink_to(here)
    monkeypatch.chdir(here)
    assert "is not empty (config.yaml ...)" in refused(capsys, "run", box_recording, "--out", out)
    assert content(here) == {"config.yaml": hashlib.sha256(b"seed: 3").hexdigest()}
    assert {path.name for path in here.iterdir()} == {"config.yaml"}


@pytest.mark.parametrize(("out", "found"), [("file", "is a file"), ("file/out", "is a file"), ("x" * 5000, "File name too long")])
def test_paths_that_cannot_be_folders(
    box_recording: Path, tmp_path: Path, out: str, found: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("mine")
    line = refused(capsys, "run", box_recording, "--out", tmp_path / out)
    assert f"results cannot be written there ({found}); choose another folder with --out" in line
    assert len(line) < 400
    assert content(tmp_path) == {"file": hashlib.sha256(b"mine").hexdigest()}


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_without_permission(box_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "locked").mkdir(mode=0o500)
    assert "Permission denied" in refused(capsys, "run", box_recording, "--out", tmp_path / "locked")
    assert "Permission denied" in refused(capsys, "run", box_recording, "--out", tmp_path / "locked" / "out")


def test_an_empty_folder_is_taken_and_one_that_only_a_file_manager_looked_into(box_recording: Path, tmp_path: Path) -> None:
    (tmp_path / ".DS_Store").write_bytes(b"\0")
    run_known(box_recording, tmp_path)
    assert visible_files(tmp_path) == sorted([".DS_Store", *result_folder.FILES])


# the mark


def test_the_mark_lists_what_the_run_wrote(box_recording: Path, tmp_path: Path) -> None:
    run_known(box_recording, tmp_path)
    marked = json.loads((tmp_path / LEDGER).read_text())
    assert marked["schema"] == SCHEMA == 1
    assert {name: digest for digest, name in marked["files"].items()} == {
        name: digest for name, digest in content(tmp_path).items() if name in result_folder.FILES
    }


def test_the_mark_of_a_later_version_is_refused(box_recording: Path, tmp_path: Path) -> None:
    run_known(box_recording, tmp_path)
    (tmp_path / LEDGER).write_text('{"schema": 2, "files": {}}')
    with pytest.raises(ResultError, match="has schema 2, expected at most 1; use the version of idf-slam that wrote this folder"):
        run_known(box_recording, tmp_path, overwrite=True)


@pytest.mark.parametrize(
    "text", ["", "[]", "null", '{"schema": 1}', '{"schema": 1, "files": [1]}', "[" * 9000, '{"schema": ' + "9" * 9000 + "}"]
)
def test_a_damaged_mark_marks_nothing(box_recording: Path, tmp_path: Path, text: str) -> None:
    (tmp_path / LEDGER).write_text(text)
    (tmp_path / "mesh.ply").write_text("mine")
    with pytest.raises(ResultError, match=r"is not empty \(mesh.ply ...\)"):
        run_known(box_recording, tmp_path, overwrite=True)


def test_a_copy_without_its_mark_can_be_evaluated(box_recording: Path, tmp_path: Path) -> None:
    run_known(box_recording, tmp_path / "out")
    (tmp_path / "out" / LEDGER).unlink()
    evaluate_folder(tmp_path / "out")
    assert {*result_folder.FILES, *result_folder.EVALUATION_FILES} == Ledger(tmp_path / "out").names


# earlier results


def test_results_are_replaced_only_when_that_is_said(box_recording: Path, tmp_path: Path) -> None:
    run_known(box_recording, tmp_path)
    before = content(tmp_path)
    with pytest.raises(ResultError, match="holds results already; replace them with --overwrite, or choose another folder with --out"):
        run_known(box_recording, tmp_path)
    assert content(tmp_path) == before
    evaluate_folder(tmp_path)
    run_known(box_recording, tmp_path, overwrite=True)
    assert visible_files(tmp_path) == sorted(result_folder.FILES)  # the evaluation was that of the run before
    assert not (tmp_path / output_folder.PARTIAL).exists()


def test_what_is_not_the_runs_own_stays(box_recording: Path, tmp_path: Path) -> None:
    run_known(box_recording, tmp_path)
    (tmp_path / "pictures").mkdir()
    mine = ["report.html", "notes.txt", "mesh2.ply", "error.png", "recording.rrd", "pictures/mesh_1.png", "evaluation.json"]
    for name in mine:
        (tmp_path / name).write_text(f"mine: {name}")
    run_known(box_recording, tmp_path, overwrite=True)
    assert {name: (tmp_path / name).read_text() for name in mine} == {name: f"mine: {name}" for name in mine}


@pytest.mark.parametrize("name", ["mesh.ply", "config.yaml", "trajectory.txt"])
def test_a_file_of_somebody_else_in_a_results_place_is_not_replaced(box_recording: Path, tmp_path: Path, name: str) -> None:
    run_known(box_recording, tmp_path)
    (tmp_path / name).write_text("mine")
    before = content(tmp_path)
    with pytest.raises(ResultError, match=f"{name}: was changed since idf-slam wrote it, so it is not replaced; move it away"):
        run_known(box_recording, tmp_path, overwrite=True)
    assert content(tmp_path) == before


def test_a_run_that_fails_leaves_the_earlier_results(box_recording: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    run_known(box_recording, tmp_path)
    before = content(tmp_path)

    class Observing(DivergingSlam):
        def process(self, frame: Any) -> Any:
            assert all((tmp_path / name).exists() for name in result_folder.FILES)
            return super().process(frame)

    with pytest.raises(Exception, match="keyframe 6"):
        run_known(box_recording, tmp_path, Observing, overwrite=True)
    after = content(tmp_path)
    assert {name: after[name] for name in before} == before
    partial = tmp_path / output_folder.PARTIAL
    assert len(load_tum(partial / result_folder.TRAJECTORY)) == 6
    assert f"the earlier results stay; the poses of this run are in {partial}" in caplog.text
    assert is_unfinished(tmp_path)
    with pytest.raises(ResultError, match="holds an unfinished run; continue it with --resume"):
        run_known(box_recording, tmp_path)
    run_known(box_recording, tmp_path, overwrite=True)
    assert not is_unfinished(tmp_path)


def test_ctrl_c_writes_the_results_so_far_over_earlier_ones(box_recording: Path, tmp_path: Path) -> None:
    run_known(box_recording, tmp_path)
    run_known(box_recording, tmp_path, InterruptedSlam, overwrite=True)
    assert len(load_tum(tmp_path / result_folder.TRAJECTORY)) == 4
    assert visible_files(tmp_path) == sorted(result_folder.FILES)


def test_a_run_without_any_pose_leaves_nothing(box_recording: Path, tmp_path: Path) -> None:
    class Blind(NearlyRightSlam):
        def stored_keyframes(self) -> list[Any]:
            return []

    with pytest.raises(Exception, match="has depth, so there is nothing to map"):
        run_known(box_recording, tmp_path / "out", Blind)
    assert not (tmp_path / "out").exists()


class FullDisk(NearlyRightSlam):
    """The disk has no room for the map."""

    def save_map(self, path: Path) -> None:
        raise OSError(errno.ENOSPC, "No space left on device", str(path))


def test_a_full_disk_leaves_the_poses(box_recording: Path, tmp_path: Path) -> None:
    with pytest.raises(ResultError, match=r"cannot be written \(No space left on device\); make room or give permission"):
        run_known(box_recording, tmp_path, FullDisk)
    assert len(load_tum(tmp_path / result_folder.TRAJECTORY)) == BOX_FRAMES
    assert result_folder.FRAMES in visible_files(tmp_path)
    assert result_folder.METRICS not in visible_files(tmp_path)
    assert is_unfinished(tmp_path)


def test_a_full_disk_leaves_earlier_results_whole(box_recording: Path, tmp_path: Path) -> None:
    run_known(box_recording, tmp_path)
    before = content(tmp_path)
    with pytest.raises(ResultError, match="No space left on device"):
        run_known(box_recording, tmp_path, FullDisk, overwrite=True)
    after = content(tmp_path)
    assert {name: after[name] for name in before} == before


@pytest.mark.parametrize("moved", range(len(result_folder.FILES)))
def test_a_process_that_dies_while_files_are_moved_can_be_resumed(
    box_recording: Path, tmp_path: Path, moved: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Until the last file, the config, is in its place, the run counts as unfinished, and every file as the program's own."""
    run_known(box_recording, tmp_path)
    partial = tmp_path / output_folder.PARTIAL
    partial.mkdir()
    for name in result_folder.FILES:
        (partial / name).write_text(f"new {name}")
    count = itertools.count()

    def replace(source: Path, target: Path) -> None:
        if source.parent == partial and next(count) == moved:
            raise KeyboardInterrupt
        source.rename(target)

    monkeypatch.setattr("idfslam.runs.run_folder.os.replace", replace)
    with pytest.raises(KeyboardInterrupt):
        RunFolder(tmp_path, made=False, replaces=True).swap()
    monkeypatch.undo()
    assert sum((tmp_path / name).read_text(errors="replace").startswith("new ") for name in result_folder.FILES) == moved
    assert is_unfinished(tmp_path)
    assert config_folder(tmp_path) == partial
    assert all(Ledger(tmp_path).owns(name) for name in result_folder.FILES)
    with claimed(tmp_path, resume=True) as place:
        for name in result_folder.FILES:
            (partial / name).write_text(f"new {name}")
        place.swap()
    assert all((tmp_path / name).read_text() == f"new {name}" for name in result_folder.FILES)
    assert not is_unfinished(tmp_path)


@pytest.mark.parametrize("name", ["../mine.txt", "pictures/../../mine.txt", "{absolute}"])
def test_a_ledger_reaches_no_file_outside_its_folder(tmp_path: Path, name: str) -> None:
    """A folder that was made by somebody else may come with a ledger that names the user's files by their content."""
    mine, folder = tmp_path / "mine.txt", tmp_path / "folder"
    mine.write_text("mine")
    (folder / "pictures").mkdir(parents=True)
    named = {hashlib.sha256(b"mine").hexdigest(): name.format(absolute=mine)}
    (folder / LEDGER).write_text(json.dumps({"schema": SCHEMA, "files": named}))
    ledger = Ledger(folder)
    assert ledger.names == set()
    ledger.remove(ledger.names)
    assert mine.read_text() == "mine"


# folders in use


def hold(folder: Path, ready: Any, end: Any) -> None:
    with claimed(folder):
        ready.set()
        end.wait()


def test_a_folder_in_use_is_refused_and_a_killed_process_does_not_block_it(
    box_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    context = multiprocessing.get_context("spawn")
    ready, end = context.Event(), context.Event()
    holder = context.Process(target=hold, args=(tmp_path / "out", ready, end))
    holder.start()
    assert ready.wait(60)
    line = refused(capsys, "run", box_recording, "--out", tmp_path / "out")
    assert line.endswith("out: another idf-slam is writing there; wait until it ends, or choose another folder with --out")
    assert visible_files(tmp_path / "out") == []
    holder.kill()
    holder.join()
    run_known(box_recording, tmp_path / "out")
    assert visible_files(tmp_path / "out") == sorted(result_folder.FILES)


def test_two_recordings_of_one_name_do_not_share_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    taken = []
    for _ in range(3):
        taken.append(folder_for("room", None, overwrite=False))
        with claimed(taken[-1]) as place:
            (place.partial / result_folder.TRAJECTORY).write_text("")
            place.swap()
    assert [str(folder) for folder in taken] == ["results/room", "results/room-2", "results/room-3"]
    assert folder_for("room", None, overwrite=True) == Path("results/room")


def test_a_run_that_fails_at_once_leaves_its_name_to_the_next(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ResultError), claimed(folder_for("room", None, overwrite=False)):
        raise ResultError("no GPU")
    assert folder_for("room", None, overwrite=False) == Path("results/room")


def test_a_default_folder_of_somebody_else_is_left_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "results" / "room").mkdir(parents=True)
    (tmp_path / "results" / "room" / "paper.tex").write_text("mine")
    with caplog.at_level("INFO", "idfslam"):
        assert folder_for("room", None, overwrite=False) == Path("results/room-2")
    assert "results/room is taken: the results go to results/room-2" in caplog.text
    with pytest.raises(ResultError, match="is not empty"):
        check_usable(folder_for("room", None, overwrite=True), overwrite=True)


def test_a_report_of_somebody_else_is_told_before_the_run(box_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run_known(box_recording, tmp_path)
    (tmp_path / "report.html").write_text("mine")
    line = refused(capsys, "run", box_recording, "--out", tmp_path, "--overwrite")
    assert "report.html: was not written by idf-slam, so it is not replaced; move it away" in line
    source = RecordingSource(str(box_recording))
    run(open_source(source), FAST, tmp_path, source=source, make_slam=NearlyRightSlam, overwrite=True)  # a run alone writes no report
    assert (tmp_path / "report.html").read_text() == "mine"
