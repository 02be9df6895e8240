"""The error about a folder that is nearly a recording names what it lacks."""

from collections.abc import Callable
from pathlib import Path

import pytest

from helpers.recordings import write_folder, write_seven_scenes, write_tum
from idfslam.datasets import open_recording
from idfslam.errors import RecordingError


def made(*names: str) -> Callable[[Path], None]:
    """A folder of empty files, and folders where a name ends with a slash."""

    def make(path: Path) -> None:
        for name in names:
            (path / name).parent.mkdir(parents=True, exist_ok=True)
            (path / name).mkdir() if name.endswith("/") else (path / name).write_bytes(b"")

    return make


def without(write: Callable[[Path], object], *patterns: str) -> Callable[[Path], None]:
    """A recording without the files and folders of these patterns."""

    def make(path: Path) -> None:
        write(path)
        for pattern in patterns:
            for entry in list(path.glob(pattern)):
                entry.rename(path.parent / f"{entry.name} elsewhere")

    return make


NEAR = {
    "Stray Scanner without video": (
        made("depth/", "odometry.csv", "camera_matrix.csv", "confidence/"),
        r"looks like a Stray Scanner folder without rgb\.mp4, expected rgb\.mp4 and depth/ and odometry\.csv",
    ),
    "Stray Scanner without depth": (made("rgb.mp4", "odometry.csv"), "looks like a Stray Scanner folder without depth/"),
    "TUM without depth": (without(write_tum, "depth.txt", "depth"), r"looks like a TUM sequence without depth\.txt"),
    "TUM without a list": (
        without(write_tum, "depth.txt"),
        r"depth\.txt is missing, expected rgb\.txt and depth\.txt, or associations\.txt, or --format folder",
    ),
    "colour alone": (
        without(write_folder, "depth"),
        r"looks like a folder of images without depth images \(depth/\), expected colour images \(rgb/ or color/\) and depth images",
    ),
    "depth alone": (without(write_folder, "rgb"), r"looks like a folder of images without colour images \(rgb/ or color/\)"),
    "photos": (
        made("IMG_0001.JPG", "IMG_0002.JPG"),
        "looks like a folder of images without depth images .*found IMG_0001.JPG, IMG_0002.JPG",
    ),
    "a video": (made("clip.mp4"), r"looks like a folder of images without depth images .*found clip\.mp4"),
    "Record3D without metadata": (made("rgbd/0.jpg"), "looks like an unpacked recording of Record3D without metadata"),
    "7-Scenes without depth": (without(write_seven_scenes, "*.depth.png"), "3 colour images, but no depth images"),
    "ScanNet without depth": (made("color/", "intrinsic/"), "looks like an exported ScanNet scene without depth/"),
    "something else": (
        made("letter.docx"),
        r"not a known recording: found letter\.docx, expected one of scannet .*; folder \(rgb/ or color/",
    ),
}


@pytest.mark.parametrize("name", NEAR)
def test_the_nearest_layout_is_named(name: str, tmp_path: Path) -> None:
    make, message = NEAR[name]
    (tmp_path / "scan").mkdir()
    make(tmp_path / "scan")
    with pytest.raises(RecordingError, match=message) as caught:
        open_recording(tmp_path / "scan")
    assert "\n" not in str(caught.value)
