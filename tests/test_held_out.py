"""Frames that a run holds out, and the comparison of views with them."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
from rich.console import Console

from helpers.small_config import small
from idfslam.cli.command_line import main
from idfslam.datasets import open_recording
from idfslam.errors import ResultError
from idfslam.graph.held_out import is_held_out
from idfslam.pictures.view_comparison import PICTURE, VIEWS, compare_views
from idfslam.runs.finished_run import FinishedRun
from idfslam.runs.run_config import RecordingSource
from idfslam.runs.runner import run


@pytest.fixture(scope="module")
def finished(box_recording: Path, tmp_path_factory: pytest.TempPathFactory) -> FinishedRun:
    """A run of 14 frames that held every fourth out."""
    folder = tmp_path_factory.mktemp("held") / "run"
    config = replace(small(), hold_out=4)
    run(open_recording(box_recording), config, folder, source=RecordingSource(str(box_recording)), console=Console(quiet=True))
    return FinishedRun(folder)


def test_every_so_many_frames_are_held_out_and_never_the_first() -> None:
    assert [i for i in range(20) if is_held_out(i, 8)] == [7, 15]
    assert not any(is_held_out(i, 0) for i in range(20))


def test_map_keyframes_and_archive_do_without_them(finished: FinishedRun) -> None:
    archive = finished.archive
    assert archive is not None
    assert len(finished.trajectory) == 14
    for used in ({view.index for view in archive.views}, set(finished.keyframes.indices.tolist())):
        assert len(used) >= 3
        assert not used & {3, 7, 11}


def test_views_are_compared_with_them(finished: FinishedRun) -> None:
    errors = compare_views(finished)
    assert [error.index for error in errors] == [3, 7, 11]
    assert min(error.psnr for error in errors) > 20
    assert json.loads((finished.folder / VIEWS).read_text())["count"] == 3
    assert (finished.folder / PICTURE).stat().st_size > 10_000
    of_map = compare_views(finished, of_map=True)
    assert sum(error.psnr for error in of_map) < sum(error.psnr for error in errors)


def test_the_command(finished: FinishedRun, capsys: pytest.CaptureFixture[str]) -> None:
    main(["eval", str(finished.folder), "--views"])
    assert "3 held-out views: PSNR" in capsys.readouterr().out
    with pytest.raises(SystemExit) as usage:
        main(["eval", str(finished.folder), "--views", "--gt", "truth.txt"])
    assert usage.value.code == 2
    assert "leave out --gt" in capsys.readouterr().err


def test_a_run_that_held_nothing_out(known_run: Path) -> None:
    with pytest.raises(ResultError, match="run again with --hold-out 8"):
        compare_views(FinishedRun(known_run))
