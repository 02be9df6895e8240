"""Plain folders as people have them: names of folders, both kinds in one folder, names with stamps or other numbers in them."""

import logging
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from helpers.recordings import DEPTH, HEIGHT, WIDTH, colour_image, depth_image, write_folder
from idfslam.datasets import open_recording
from idfslam.errors import RecordingError

Name = Callable[[int], str]


def write(path: Path, colour: Name, depth: Name, *, frames: int = 4, depths: int | None = None) -> Path:
    """A folder with an intrinsics.txt and images at these paths; frame i has red 10 + i."""
    for i in range(frames):
        (path / colour(i)).parent.mkdir(parents=True, exist_ok=True)
        assert cv2.imwrite(str(path / colour(i)), colour_image(i))
    for i in range(frames if depths is None else depths):
        (path / depth(i)).parent.mkdir(parents=True, exist_ok=True)
        assert cv2.imwrite(str(path / depth(i)), depth_image(1000 + i))
    (path / "intrinsics.txt").write_text("15 0 7.5\n0 15 5.5\n0 0 1\n")
    return path


def check(path: Path, frames: list[tuple[int, int]] | int = 4) -> None:
    """The recording has these (colour, depth) images as its frames."""
    recording = open_recording(path)
    expected = [(i, i) for i in range(frames)] if isinstance(frames, int) else frames
    assert len(recording) == len(expected)
    for frame, (i, k) in enumerate(expected):
        assert recording[frame].colour[6, 8, 0] == pytest.approx((10 + i) / 255, abs=2.5 / 255)
        assert recording[frame].depth[6, 8] == pytest.approx(DEPTH + k / 1000, abs=1e-5)


@pytest.mark.parametrize("colour", ["rgb", "RGB", "Color", "colour", "images", "Image", "rgb_images", "color_0", "left_rgb"])
@pytest.mark.parametrize("depth", ["depth", "Depth", "DEPTH", "depths", "depth_images", "aligned_depth", "depth_raw"])
def test_names_of_folders(colour: str, depth: str, tmp_path: Path) -> None:
    check(write(tmp_path / "room", lambda i: f"{colour}/{i:06d}.JPG", lambda i: f"{depth}/{i:06d}.PNG"))


def test_of_several_folders_the_usual_name_counts(tmp_path: Path) -> None:
    path = write(tmp_path / "room", lambda i: f"rgb/{i}.png", lambda i: f"depth/{i}.png")
    for name in ("RGB", "images", "depth_vis", "depth_conf"):
        (path / name).mkdir()
    check(path)


ONE_FOLDER: dict[str, tuple[Name, Name]] = {
    "suffix": (lambda i: f"{i:04d}_color.png", lambda i: f"{i:04d}_depth.png"),
    "prefix": (lambda i: f"rgb_{i:04d}.jpg", lambda i: f"depth_{i:04d}.png"),
    "BundleFusion": (lambda i: f"frame-{i:06d}.color.jpg", lambda i: f"frame-{i:06d}.depth.png"),
    "aligned": (lambda i: f"{i}_color.png", lambda i: f"{i}_depth_aligned_to_color.png"),
    "colour without a word": (lambda i: f"{i}.jpg", lambda i: f"{i}.depth.png"),
    "d": (lambda i: f"c_{i}.jpg", lambda i: f"d_{i}.png"),
    "numbers of sizes": (lambda i: f"{i:06d}_color_640x480.jpg", lambda i: f"{i:06d}_depth_640x480.png"),
    "images": (lambda i: f"images/{i}.jpg", lambda i: f"images/{i}_depth.png"),
    "capitals": (lambda i: f"Color_{i}.JPG", lambda i: f"Depth_{i}.PNG"),
}


@pytest.mark.parametrize("name", ONE_FOLDER)
def test_both_kinds_in_one_folder(name: str, tmp_path: Path) -> None:
    path = write(tmp_path / "room", *ONE_FOLDER[name])
    for other in ("ir_0001.png", "0001_infrared.png", "mask_0001.png", "0001_confidence.png"):
        cv2.imwrite(str(path / other), np.zeros((HEIGHT, WIDTH), np.uint8))
    check(path)


def test_files_of_file_managers_are_ignored(tmp_path: Path) -> None:
    path = write(tmp_path / "room", lambda i: f"rgb/{i:06d}.jpg", lambda i: f"depth/{i:06d}.png")
    for name in ("Thumbs.db", ".DS_Store", "._000001.jpg", "desktop.ini"):
        for folder in (path, path / "rgb", path / "depth"):
            (folder / name).write_bytes(b"\0\5\26\7")
    check(path)
    check(write(tmp_path / "one", *ONE_FOLDER["suffix"]))


# ----- names with numbers and stamps


def test_stamps_as_names_are_the_stamps(tmp_path: Path) -> None:
    path = write(tmp_path / "room", lambda i: f"rgb/{1.7e9 + i / 10:.6f}.jpg", lambda i: f"depth/{1.7e9 + i / 10:.6f}.png")
    check(path)
    recording = open_recording(path)
    np.testing.assert_allclose(recording.timestamps, 1.7e9 + np.arange(4) / 10, rtol=0, atol=1e-6)
    assert recording.provenance is not None and recording.provenance.stamps == "file names"


def test_timestamps_txt_wins_over_names(tmp_path: Path) -> None:
    path = write(tmp_path / "room", lambda i: f"rgb/{1.7e9 + i / 10:.1f}.jpg", lambda i: f"depth/{1.7e9 + i / 10:.1f}.png")
    (path / "timestamps.txt").write_text("5\n6\n7\n8\n")
    np.testing.assert_allclose(open_recording(path).timestamps, [5, 6, 7, 8])


def test_pairs_by_the_nearest_stamp(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Depth is 4 ms late, and its frame 2 is missing; at 30 Hz half a frame is 17 ms."""
    path = write(tmp_path / "room", lambda i: f"rgb/{1.7e9 + i / 30:.6f}.jpg", lambda i: f"depth/{1.7e9 + i / 30 + 0.004:.6f}.png")
    check(path)
    assert not caplog.records
    (path / f"depth/{1.7e9 + 2 / 30 + 0.004:.6f}.png").unlink()
    check(path, [(0, 0), (1, 1), (2, 1), (3, 3)])  # 29 ms before and 37 ms after
    recording = open_recording(path)
    np.testing.assert_allclose(recording.timestamps, 1.7e9 + np.arange(4) / 30, rtol=0, atol=1e-6)
    np.testing.assert_allclose([recording[i].depth_lag for i in range(4)], [0.004, 0.004, 0.004 - 1 / 30, 0.004], atol=2e-6)
    assert "1 of 4 colour images have no depth image of their own" in caplog.text


def test_the_names_of_rs_convert(tmp_path: Path) -> None:
    """RealSense's rs-convert: one folder, milliseconds with decimals; depth 3 ms before colour."""
    path = write(
        tmp_path / "room", lambda i: f"x_Color_{1694.123 + i * 33.367:.14f}.png", lambda i: f"x_Depth_{1691.12 + i * 33.367:.14f}.png"
    )
    check(path)
    np.testing.assert_allclose(open_recording(path).timestamps, 1.694123 + np.arange(4) * 0.033367, atol=1e-9)


def test_stamps_of_other_clocks_are_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "room", lambda i: f"rgb/{1.7e9 + i / 30:.6f}.jpg", lambda i: f"depth/{1.6e9 + i / 30:.6f}.png")
    with pytest.raises(RecordingError, match="none within half a frame: expected stamps of one clock"):
        open_recording(path)


def test_other_numbers_are_paired_in_their_order_and_that_is_said(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = write(tmp_path / "room", lambda i: f"rgb/{i:04d}.jpg", lambda i: f"depth/{i + 1:04d}.png")
    with caplog.at_level(logging.WARNING):
        check(path)
    assert "colour and depth images have different numbers; they are paired in their order: rgb/0000.jpg with depth/0001.png" in caplog.text


def test_other_numbers_and_counts_are_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "room", lambda i: f"rgb/{i}.jpg", lambda i: f"depth/{i + 100}.png", depths=3)
    with pytest.raises(RecordingError, match="4 colour and 3 depth images"):
        open_recording(path)


def test_equal_numbers_win_over_order(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = write_folder(tmp_path / "room", frames=5)
    assert len(open_recording(path)) == 5
    (path / "rgb/000000.jpg").rename(path / "rgb/000009.jpg")
    assert len(open_recording(path)) == 5
    assert "1 image is left out: depth/000000.png has no partner of the same number" in caplog.text
    assert "1 of 5 colour images have no depth image of their own" in caplog.text


@pytest.mark.parametrize(
    "names",
    [["amber", "birch", "cedar"], ["3f2b-aa02", "7c1d-4b", "9e-0f02"], ["0001a2b8", "0001a2bb", "0001a2be"], ["1a", "1b", "1c"]],
)
def test_images_whose_names_are_no_numbers_are_paired_by_name(names: list[str], tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "kitchen")
    expected = [frame.depth for frame in open_recording(folder)]
    for kind in ("rgb", "depth"):
        for file, name in zip(sorted((folder / kind).iterdir()), names):
            file.rename(file.with_name(name + file.suffix))
    recording = open_recording(folder)
    assert len(recording) == 3
    for frame, depth in zip(recording, expected):
        np.testing.assert_array_equal(frame.depth, depth)


def test_photographs_and_depth_of_the_same_names_in_one_folder(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "kitchen")
    expected = [frame.depth for frame in open_recording(folder)]
    for file in (folder / "rgb").iterdir():
        assert cv2.imwrite(str(folder / f"{file.stem}.jpg"), cv2.imread(str(file)))
        file.unlink()
    for file in (folder / "depth").iterdir():
        file.rename(folder / file.name)
    (folder / "rgb").rmdir()
    (folder / "depth").rmdir()
    for frame, depth in zip(open_recording(folder), expected, strict=True):
        np.testing.assert_array_equal(frame.depth, depth)
