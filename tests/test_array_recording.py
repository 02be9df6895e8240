"""One file with all frames: HDF5, MATLAB 5 and 7.3 (as NYU's labelled set), .npz; axes in every order in use."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from helpers.array_recordings import DEPTH, POSES, RGB, STAMPS, K, write_hdf5, write_mat, write_mat_73, write_npz
from helpers.recordings import HEIGHT, WIDTH
from idfslam.datasets import open_recording
from idfslam.errors import RecordingError
from idfslam.geometry.camera import Camera

WRITERS = {"HDF5": write_hdf5, "npz": write_npz, "MATLAB 5": write_mat, "MATLAB 7.3": write_mat_73}
Write = Callable[..., Path]


@pytest.mark.parametrize("write", WRITERS.values(), ids=WRITERS)
@pytest.mark.parametrize("where", ["the file", "its folder"])
def test_all_frames_in_one_file(write: Write, where: str, tmp_path: Path) -> None:
    path = write(tmp_path / "room", depths=DEPTH, images=RGB, K=K, timestamps=STAMPS, poses=POSES)
    recording = open_recording(path if where == "the file" else tmp_path)
    assert recording.name == "room" and len(recording) == 4 and recording.camera == Camera(WIDTH, HEIGHT, 15.0, 15.0, 7.5, 5.5)
    np.testing.assert_allclose(recording.timestamps, STAMPS)
    for i in (3, 0):
        np.testing.assert_allclose(recording[i].colour, RGB[i] / 255, atol=1e-6)
        np.testing.assert_allclose(recording[i].depth, DEPTH[i])
    assert recording.ground_truth is not None
    np.testing.assert_allclose(recording.ground_truth, POSES)


@pytest.mark.parametrize("write", WRITERS.values(), ids=WRITERS)
def test_integers_are_millimetres_and_the_camera_lies_beside(write: Write, tmp_path: Path) -> None:
    path = write(tmp_path / "room", rawDepths=np.rint(1000 * DEPTH).astype(np.uint16), rgb=(RGB / 255).astype(np.float32))
    (tmp_path / "intrinsics.txt").write_text("15 15 7.5 5.5\n")
    recording = open_recording(path)
    np.testing.assert_allclose(recording[2].depth, DEPTH[2], rtol=1e-6)
    np.testing.assert_allclose(recording[2].colour, RGB[2] / 255, atol=1e-6)
    np.testing.assert_allclose(recording.timestamps, np.arange(4) / 30)
    assert recording.ground_truth is None


def test_channels_may_come_first(tmp_path: Path) -> None:
    path = write_npz(tmp_path / "room", depth=DEPTH, color=np.moveaxis(RGB, -1, 1), intrinsics=K)
    np.testing.assert_allclose(open_recording(path)[1].colour, RGB[1] / 255, atol=1e-6)


def test_what_is_missing_is_named(tmp_path: Path) -> None:
    path = write_npz(tmp_path / "room", images=RGB)
    with pytest.raises(RecordingError, match=r"room\.npz: holds images \(4, 12, 16, 3\), expected an array of depth"):
        open_recording(path)
    path = write_npz(tmp_path / "room", images=RGB, depth=DEPTH[:3])
    with pytest.raises(RecordingError, match="expected equally many images of one size, colour with 3 channels"):
        open_recording(path)
    path = write_npz(tmp_path / "room", images=RGB, depth=DEPTH)
    with pytest.raises(RecordingError, match="the camera is unknown"):
        open_recording(path)
    (tmp_path / "other").mkdir()
    write_npz(tmp_path / "other/calibration", K=K)
    with pytest.raises(RecordingError, match=r"not a known recording: found calibration\.npz"):
        open_recording(tmp_path / "other")


@pytest.mark.parametrize("write", WRITERS.values(), ids=WRITERS)
def test_damaged_files_are_one_line(write: Write, tmp_path: Path) -> None:
    path = write(tmp_path / "room", depths=DEPTH, images=RGB, K=K)
    whole, random = path.read_bytes(), np.random.default_rng(3)
    cases = [b"", b"rubbish", whole[: len(whole) // 2], whole[:100]]
    for at in random.integers(0, min(len(whole), 3000), 40):
        cases.append(whole[:at] + bytes([int(random.integers(256))]) + whole[at + 1 :])
    for data in cases:
        path.unlink()
        path.write_bytes(data)
        try:
            recording = open_recording(path)
            assert len(recording) >= 1
        except RecordingError as error:
            assert "\n" not in str(error) and len(str(error)) < 600
