"""Recording: what comes back is what was seen, and at whatever moment it ends, what was stored can be read."""

import errno
import os
import signal
import threading
from pathlib import Path

import numpy as np
import pytest

from helpers.box_room import BOX_FRAMES
from helpers.live_cameras import HandFed, capture
from helpers.recordings import write_folder
from idfslam.cli import command_line
from idfslam.datasets import open_recording
from idfslam.errors import RecordingError, ResultError
from idfslam.frame import Frame
from idfslam.geometry.camera import Camera
from idfslam.live import LiveStream, open_live
from idfslam.live.recorder import bgr, millimetres, record


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_a_recording_comes_back(box_recording: Path, tmp_path: Path) -> None:
    reports: list[tuple[int, int]] = []
    done = record(open_live(f"replay@0.5:{box_recording}"), tmp_path / "a", png=True, report=lambda *counts: reports.append(counts))
    source, copy = open_recording(box_recording), open_recording(tmp_path / "a")
    assert (done.frames, done.dropped) == (BOX_FRAMES, 0)
    assert reports[-1] == (BOX_FRAMES, 0)
    assert names(tmp_path / "a") == ["depth", "intrinsics.txt", "rgb", "timestamps.txt"]
    assert len(copy) == BOX_FRAMES
    assert copy.camera == source.camera
    assert np.allclose(copy.timestamps, source.timestamps, atol=1e-6)
    for i in (0, 7, 13):
        assert np.array_equal(copy[i].colour, source[i].colour)
        assert np.array_equal(copy[i].depth, source[i].depth)


def test_jpeg_is_near_and_small(box_recording: Path, tmp_path: Path) -> None:
    record(open_live(f"replay@0.5:{box_recording}", frames=2), tmp_path)
    assert names(tmp_path / "rgb") == ["000000.jpg", "000001.jpg"]
    difference = open_recording(tmp_path)[1].colour - open_recording(box_recording)[1].colour
    assert np.abs(difference).mean() < 0.01


def test_what_images_cannot_hold_is_no_reading() -> None:
    camera = Camera(4, 1, 4.0, 4.0, 1.5, 0.0)
    frame = Frame(0, 0.0, np.zeros((1, 4, 3), np.float32), np.array([[1.2344, 65.534, 65.535, 80.0]], np.float32), camera)
    assert millimetres(frame).tolist() == [[1234, 65534, 0, 0]]
    orange = np.tile(np.array([1.0, 0.5, 0.0], np.float32), (1, 4, 1))
    assert bgr(Frame(0, 0.0, orange, frame.depth, camera)).tolist() == [[[0, 128, 255]] * 4]


def test_stops_after_seconds(box_recording: Path, tmp_path: Path) -> None:
    done = record(open_live(f"replay@0.2:{box_recording}"), tmp_path, seconds=0.5)  # 2.2 s in all
    assert 1 <= done.frames <= 8
    assert len(open_recording(tmp_path)) == done.frames


@pytest.mark.slow
def test_ctrl_c_ends_it_and_all_that_was_stored_is_whole(tmp_path: Path) -> None:
    device = HandFed()

    def feed() -> None:
        for stamp in range(100):
            if stamp == 5:
                os.kill(os.getpid(), signal.SIGINT)
            device.give(capture(1 + stamp))

    threading.Thread(target=feed, daemon=True).start()
    done = record(LiveStream(device), tmp_path)
    copy = open_recording(tmp_path)
    assert 1 <= len(copy) == done.frames < 100
    assert all(np.isfinite(copy[i].depth).all() for i in range(len(copy)))


def test_a_full_disk_is_one_clear_line_and_loses_nothing(box_recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write = Path.write_bytes

    def full(path: Path, data: bytes) -> int:
        if "000004" in path.name and path.parent.name == "depth":
            write(path, data[:10])
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return write(path, data)

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(ResultError, match=r"cannot be written \(No space left on device\); the \d+ frames stored before can be read"):
        record(open_live(f"replay@0.5:{box_recording}"), tmp_path)
    copy = open_recording(tmp_path)
    assert 3 <= len(copy) <= 5  # 0 to 3, but for one that another thread was at
    assert all(copy[i].depth.any() for i in range(len(copy)))
    assert not [name for folder in ("rgb", "depth") for name in names(tmp_path / folder) if name.startswith(".")]


def test_a_recording_that_was_killed_can_be_read(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "a", frames=5)
    for pose in (folder / "pose").iterdir():
        pose.unlink()
    (folder / "timestamps.txt").write_text("000001 10.5\n000000 10.25\n000002 11.0\n000003 11.")  # cut off in the last line
    (folder / "depth" / "000004.png").unlink()
    (folder / "depth" / ".part-000004.png").write_bytes(b"half")
    recording = open_recording(folder)
    assert recording.timestamps.tolist() == [10.25, 10.5, 11.0]
    assert recording[2].timestamp == 11.0


def test_stamps_of_other_forms(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "a", frames=3)
    stamps = folder / "timestamps.txt"
    for text in (
        "# seconds\n5.0\n5.5\n6.25",
        "timestamp\n5.0\n5.5\n6.25\n",
        "\ufeff0,5.0\r\n1,5.5\r\n2,6.25\r\n",
        "2 6.25 rgb/2.png\n1 5.5 rgb/1.png\n0 5.0 rgb/0.png\n",
        "0 5.0\n1 5.5\n2 6.25\n7 7.0\n",  # number 7 has no images
    ):
        stamps.write_bytes(text.encode())
        assert open_recording(folder).timestamps.tolist() == [5.0, 5.5, 6.25], text
    for text, message in (
        ("5.0\n5.5\n", "2 stamps for 3 images"),
        ("0 5.0\nx 5.5\n2 6.0\n", "line 2 begins with no number"),
    ):
        stamps.write_text(text)
        with pytest.raises(RecordingError, match=message):
            open_recording(folder)


@pytest.mark.parametrize("line", ["1", "1 x", "1 nan", "1 7.0", "1 5.0"])
def test_a_stamp_that_is_missing_or_does_not_increase_is_interpolated(line: str, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    folder = write_folder(tmp_path / "a", frames=4)
    (folder / "timestamps.txt").write_text(f"0 5.0\n{line}\n2 6.0\n3 6.5\n")
    assert open_recording(folder).timestamps.tolist() == [5.0, 5.5, 6.0, 6.5]
    assert "1 of 4 stamps are missing, or not later than the one before" in caplog.text


def test_stamps_of_the_colour_images_alone(tmp_path: Path) -> None:
    """A colour image is missing: the lines are as many as the colour images, and fewer than the frames."""
    folder = write_folder(tmp_path / "a", frames=4)
    (folder / "rgb/000002.jpg").unlink()
    (folder / "timestamps.txt").write_text("5.0\n5.5\n6.5\n")
    assert open_recording(folder).timestamps.tolist() == [5.0, 5.5, 6.5]
    (folder / "timestamps.txt").write_text("5.0\n5.5\n6.0\n6.5\n")
    assert open_recording(folder).timestamps.tolist() == [5.0, 5.5, 6.5]


def test_a_folder_with_a_recording_is_refused(box_recording: Path, tmp_path: Path) -> None:
    write_folder(tmp_path / "a")
    before = names(tmp_path / "a" / "rgb")
    with pytest.raises(ResultError, match="holds a recording already"):
        record(open_live(f"replay:{box_recording}"), tmp_path / "a")
    assert names(tmp_path / "a" / "rgb") == before


def test_the_command(box_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command_line.main(["record", f"replay@0.5:{box_recording}", "--out", str(tmp_path / "a"), "--frames", "3"])
    assert "3 frames in " in capsys.readouterr().out
    assert len(open_recording(tmp_path / "a")) == 3
    with pytest.raises(SystemExit) as caught:
        command_line.main(["record", "replay:nowhere", "--out", str(tmp_path / "b")])
    assert caught.value.code == 1
    assert "nowhere: no such file or folder" in capsys.readouterr().err
    assert not (tmp_path / "b").exists()
