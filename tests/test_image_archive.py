"""The archive of images in a file, and files that are none."""

import json
from pathlib import Path

import numpy as np
import pytest
from safetensors import safe_open
from safetensors.torch import load_file, save_file

from helpers.painted_wall import CAMERA, at, painted
from idfslam.errors import ResultError
from idfslam.frame import Frame
from idfslam.views.encoded_view import MOVING, encode
from idfslam.views.image_archive import ImageArchive, archive_of, load_archive, save_archive


@pytest.fixture(scope="module")
def archive() -> ImageArchive:
    poses = [at(0.1 * i) for i in range(3)]
    return archive_of([encode(painted(7 + i, T), 0.25 * i) for i, T in enumerate(poses)], CAMERA, np.stack(poses))


@pytest.fixture
def saved(archive: ImageArchive, tmp_path: Path) -> Path:
    save_archive(tmp_path / "archive.safetensors", archive)
    return tmp_path / "archive.safetensors"


def damaged(path: Path, **changes: object) -> Path:
    """The file with other metadata (text) or tensors."""
    with safe_open(path, "pt") as file:
        metadata = dict(file.metadata())
    tensors = load_file(path)
    for name, value in changes.items():
        (metadata if isinstance(value, str) else tensors)[name] = value  # type: ignore[assignment, index]
    save_file(tensors, path, metadata)
    return path


def test_an_archive_comes_back(archive: ImageArchive, saved: Path) -> None:
    loaded = load_archive(saved)
    assert [view.index for view in loaded.views] == [7, 8, 9]
    assert [view.sharpness for view in loaded.views] == [0, 0.25, 0.5]
    assert loaded.camera == CAMERA
    np.testing.assert_array_equal(loaded.T_wc, archive.T_wc)
    np.testing.assert_array_equal(loaded.exposures, archive.exposures)
    assert [view.colour for view in loaded.views] == [view.colour for view in archive.views]
    assert loaded.size == archive.size


def test_images_are_close_to_the_recorded_ones(archive: ImageArchive) -> None:
    frame = painted(8, at(0.1))
    assert np.abs(archive.colour(1) / np.float32(255) - frame.colour).mean() < 0.01
    view = archive.depths[1]
    assert view.depth.shape == (120, 160)
    assert np.abs(view.depth - frame.depth).max() <= 0.0005001  # millimetres


def test_black_borders_are_no_part_of_the_images() -> None:
    poses, frames = [at(0.1 * i) for i in range(3)], []
    for i, T in enumerate(poses):
        frame = painted(i, T)
        frame.colour[:, :10] = 0
        frame.colour[50:60, 60:70] = 0  # something black in the middle
        frames.append(encode(frame, 0.5))
    lit = archive_of(frames, CAMERA, np.stack(poses)).lit
    assert not lit[:, :13].any()
    assert lit[:, 14:].all()


def test_what_moves_is_marked() -> None:
    frame, moving = painted(0, at(0.0)), np.zeros((120, 160), bool)
    moving[30:50, 40:60] = True
    depth = archive_of([encode(frame, 0.5, moving)], CAMERA, np.eye(4)[None]).depths[0].depth
    np.testing.assert_array_equal(depth < 0, moving)
    assert (depth[moving] == MOVING).all()


def test_a_dark_scene_is_no_border() -> None:
    dark = Frame(0, 0.0, np.full((120, 160, 3), 0.02, np.float32), np.ones((120, 160), np.float32), CAMERA)
    assert archive_of([encode(dark, 0.5)], CAMERA, np.eye(4)[None]).lit.all()


def test_equal_archives_give_equal_files(archive: ImageArchive, saved: Path, tmp_path: Path) -> None:
    save_archive(tmp_path / "again", archive)
    assert (tmp_path / "again").read_bytes() == saved.read_bytes()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"format": "2"}, "archive format 2, expected 1"),
        ({"camera": json.dumps({"width": 0})}, "cannot be read as an archive of images"),
        ({"camera": "[]"}, "cannot be read as an archive of images"),
    ],
)
def test_a_file_of_another_kind_is_refused(saved: Path, changes: dict[str, str], message: str) -> None:
    with pytest.raises(ResultError, match=message):
        load_archive(damaged(saved, **changes))


@pytest.mark.parametrize("name", ["lit", "colour_ends", "T_wc", "exposures", "index"])
def test_tensors_that_do_not_fit_are_refused(saved: Path, name: str) -> None:
    with pytest.raises(ResultError, match="cannot be read as an archive of images"):
        load_archive(damaged(saved, **{name: load_file(saved)[name][:-1].clone()}))


def test_damaged_images_are_named(saved: Path) -> None:
    loaded = load_archive(damaged(saved, colour=load_file(saved)["colour"] * 0, depth=load_file(saved)["depth"] * 0))
    with pytest.raises(ResultError, match="image of frame 7 is damaged"):
        loaded.colour(0)
    with pytest.raises(ResultError, match="depth of frame 7 is damaged"):
        loaded.depths  # noqa: B018


def test_a_missing_file(tmp_path: Path) -> None:
    with pytest.raises(ResultError, match="cannot be read as an archive of images"):
        load_archive(tmp_path / "none")
