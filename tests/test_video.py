"""Frames of a video: the right one in any order, decoded once where they are asked for in order; damaged files in one line."""

import threading
from pathlib import Path

import numpy as np
import pytest

from helpers.videos import shade, write_video
from idfslam.datasets.images.video import VideoTrack
from idfslam.errors import FrameError, RecordingError

CODECS = {"h264": "mp4", "mpeg4": "avi", "mjpeg": "mkv"}  # with B-frames, key frames 12 apart, and key frames only


def shown(image: np.ndarray) -> int:
    """Which frame an image is: compression errs by less than half the step between two."""
    return int(np.argmin([np.abs(image.mean((0, 1)) - shade(i)).sum() for i in range(31)]))


def check(track: VideoTrack, i: int) -> None:
    image = track.colour(i)
    assert shown(image) == i
    np.testing.assert_allclose(image.mean((0, 1)), shade(i), atol=6)


@pytest.mark.parametrize("codec", CODECS)
def test_every_frame_in_any_order(codec: str, tmp_path: Path) -> None:
    track = VideoTrack(write_video(tmp_path / f"rgb.{CODECS[codec]}", codec=codec, frames=30))
    assert len(track) == 30 and track.size == (64, 48)
    np.testing.assert_allclose(np.diff(track.times), 1 / 30, atol=1e-3)  # mkv keeps milliseconds
    for i in [*range(30), 29, 0, 1, 15, 14, 16, 2, 28, 28]:
        check(track, i)


def test_frames_in_order_are_decoded_without_seeking(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    track = VideoTrack(write_video(tmp_path / "rgb.mp4", frames=30))
    seeks: list[int] = []
    seek = track._seek
    monkeypatch.setattr(track, "_seek", lambda i: (seeks.append(i), seek(i)))
    for i in [*range(10), 11]:  # frames between are passed over
        check(track, i)
    assert seeks == [0]
    check(track, 29)  # a key frame lies between: 24
    check(track, 28)  # backwards
    assert seeks == [0, 29, 28]


def test_frames_are_reduced_by_their_mean(tmp_path: Path) -> None:
    image = VideoTrack(write_video(tmp_path / "rgb.mp4", frames=3)).colour(2, (32, 24))
    assert image.shape == (24, 32, 3)
    np.testing.assert_allclose(image.mean((0, 1)), shade(2), atol=6)


def test_two_threads_share_a_video(tmp_path: Path) -> None:
    track, wrong = VideoTrack(write_video(tmp_path / "rgb.mp4", frames=30)), []

    def read(indices: range) -> None:
        for i in indices:
            if shown(track.colour(i)) != i:
                wrong.append(i)

    threads = [threading.Thread(target=read, args=(indices,)) for indices in (range(30), range(29, -1, -3))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong


def test_a_file_that_is_no_video(tmp_path: Path) -> None:
    for content in (b"", b"no video at all" * 100):
        (tmp_path / "rgb.mp4").write_bytes(content)
        with pytest.raises(RecordingError, match=r"rgb\.mp4: not a readable video .*: copy the recording again") as caught:
            VideoTrack(tmp_path / "rgb.mp4")
        assert "\n" not in str(caught.value)


def test_a_video_that_was_cut_off(tmp_path: Path) -> None:
    """Without its index (at the end of an mp4) nothing can be read; of an mkv what is there can."""
    whole = write_video(tmp_path / "rgb.mp4", frames=30)
    whole.write_bytes(whole.read_bytes()[:-400])
    with pytest.raises(RecordingError, match="not a readable video"):
        VideoTrack(whole)
    whole = write_video(tmp_path / "rgb.mkv", codec="mjpeg", frames=30)
    whole.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    track = VideoTrack(whole)
    assert 10 < len(track) < 20
    check(track, 9)


def test_a_damaged_frame_is_one_frame_lost(tmp_path: Path) -> None:
    path = write_video(tmp_path / "rgb.mkv", codec="mjpeg", frames=10)
    data = path.read_bytes()
    images = [place for place in range(len(data)) if data[place : place + 3] == b"\xff\xd8\xff"]
    start, end = images[4], images[5]
    path.write_bytes(data[:start] + bytes(end - start - 40) + data[end - 40 :])
    track = VideoTrack(path)
    check(track, 3)
    with pytest.raises(FrameError, match=r"rgb\.mkv: frame 4 of video track 0: .*: copy the recording again") as caught:
        track.colour(4)
    assert "\n" not in str(caught.value)
    check(track, 5)
    check(track, 2)


def test_colour_is_no_depth(tmp_path: Path) -> None:
    track = VideoTrack(write_video(tmp_path / "rgb.mp4", frames=3))
    with pytest.raises(FrameError, match="yuv420p images, expected depth as 16-bit grey"):
        track.grey16(0)
    with pytest.raises(RecordingError, match="1 video tracks, expected at least 2"):
        VideoTrack(tmp_path / "rgb.mp4", 1)
