"""What moves, shown in the report and exported as masks."""

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from helpers.box_room import BOX_CAMERA, BOX_HEIGHT, BOX_WIDTH
from idfslam.cli import command_line
from idfslam.datasets import open_recording
from idfslam.report.views import moving_strip
from idfslam.runs import result_folder
from idfslam.runs.finished_run import FinishedRun
from idfslam.views.encoded_view import encode
from idfslam.views.image_archive import archive_of, save_archive

MOVING = np.s_[30:90, 40:100]  # rows and columns of what moves in frame 6


@pytest.fixture
def run(known_run: Path, box_recording: Path, tmp_path: Path) -> Path:
    """The known run with images of frames 0, 6 and 9; something moves in frame 6."""
    folder, recording = shutil.copytree(known_run, tmp_path / "known"), open_recording(box_recording)
    moving = np.zeros((BOX_HEIGHT, BOX_WIDTH), bool)
    moving[MOVING] = True
    views = [encode(recording[i], 0.5, moving if i == 6 else None) for i in (0, 6, 9)]
    poses = FinishedRun(folder).trajectory.poses[[0, 6, 9]]
    save_archive(folder / result_folder.ARCHIVE, archive_of(views, BOX_CAMERA, poses))
    return folder


def test_masks_are_black_where_something_moves(run: Path, tmp_path: Path) -> None:
    command_line.main(["export", str(run), "--to", "masks", "--out", str(tmp_path / "out")])
    files = sorted((tmp_path / "out" / "masks").iterdir())
    assert [path.name for path in files] == ["000000.png", "000006.png", "000009.png"]
    still, moved, _ = (cv2.imread(str(path), cv2.IMREAD_UNCHANGED) for path in files)
    assert still.shape == moved.shape == (BOX_HEIGHT, BOX_WIDTH)
    assert (still == 255).all()
    expected = np.full_like(moved, 255)
    expected[MOVING] = 0
    np.testing.assert_array_equal(moved, expected)


def test_masks_of_a_run_without_images_are_refused(known_run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        command_line.main(["export", str(known_run), "--to", "masks", "--out", str(tmp_path)])
    assert "keeps no images, which tell what moves; run again without --no-archive" in capsys.readouterr().err


def test_the_report_shows_the_images_in_which_something_moves(run: Path) -> None:
    archive = FinishedRun(run).archive
    assert archive is not None
    ((caption, picture),) = moving_strip(archive)
    assert caption == "Frame 6: 19% moves"
    red = (picture[..., 0].astype(int) > picture[..., 1].astype(int) + 40) & (picture[..., 0] > 120)
    assert red[70:170, 90:190].mean() > 0.9  # the strip is twice as large
    assert red.mean() < 0.3
