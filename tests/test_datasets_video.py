"""A folder with a video in place of rgb/: pairs in order, stamps of the video, else as a plain folder."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from helpers.recordings import depth_image, pose
from helpers.videos import shade, write_video
from idfslam.datasets import open_recording
from idfslam.datasets.readers.video_folder import paired_by_number
from idfslam.errors import FrameError, RecordingError
from idfslam.geometry.camera import Camera


def write_video_folder(path: Path, *, name: str = "rgb.mp4", codec: str = "h264", frames: int = 4) -> Path:
    """64x48, depth 1 m with no reading in the first pixel; numbers of the depth images begin at 7."""
    write_video(path / name, codec=codec, frames=frames)
    for folder in ("depth", "pose"):
        (path / folder).mkdir(exist_ok=True)
    for i in range(frames):
        assert cv2.imwrite(str(path / f"depth/{i + 7:04d}.png"), depth_image(1000, (64, 48)))
        np.savetxt(path / f"pose/{i + 7:04d}.txt", pose(i))
    (path / "intrinsics.txt").write_text("60 0 31.5\n0 60 23.5\n0 0 1\n")
    return path


@pytest.mark.parametrize(("name", "codec"), [("rgb.mp4", "h264"), ("color.mkv", "mjpeg"), ("Video.AVI", "mpeg4"), ("colour.mov", "h264")])
def test_a_video_beside_depth_images(name: str, codec: str, tmp_path: Path) -> None:
    recording = open_recording(write_video_folder(tmp_path / "room", name=name, codec=codec))
    assert len(recording) == 4 and recording.name == "room"
    assert recording.camera == Camera(64, 48, 60.0, 60.0, 31.5, 23.5)
    np.testing.assert_allclose(recording.timestamps - recording.timestamps[0], np.arange(4) / 30, atol=1.1e-3)
    np.testing.assert_allclose(recording.ground_truth, [pose(i) for i in range(4)], atol=1e-6)
    for i in (3, 0, 1, 2):
        frame = recording[i]
        np.testing.assert_allclose(frame.colour.mean((0, 1)) * 255, shade(i)[::-1], atol=6)
        assert frame.depth[0, 0] == 0 and frame.depth[20, 30] == 1


def test_a_depth_camera_beside_the_video(tmp_path: Path) -> None:
    """A fifteenth of a metre to the right: 60 px * 1/15 m / 1 m = 4 px."""
    path = write_video_folder(tmp_path / "room")
    camera = {"w": 64, "h": 48, "fx": 60, "fy": 60, "cx": 31.5, "cy": 23.5, "scale": 1000}
    T = np.eye(4)
    T[0, 3] = 1 / 15
    (path / "cam_params.json").write_text(json.dumps({"camera": camera, "depth_camera": camera, "T_colour_depth": T.tolist()}))
    depth = open_recording(path)[0].depth
    assert (depth[:, :4] == 0).all() and depth[0, 4] == 0 and (depth[1:, 4:] == 1).all()


@pytest.mark.parametrize(
    ("missing", "shown"), [("0008", [0, 0, 2, 3]), ("0009", [0, 1, 1, 3]), ("0010", [0, 1, 2, 2])]
)  # the depth images are 7 to 10
def test_a_video_frame_without_a_depth_image_has_the_nearest(
    missing: str, shown: list[int], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = write_video_folder(tmp_path / "room")
    whole = open_recording(path)
    (path / f"depth/{missing}.png").unlink()
    recording = open_recording(path)
    assert recording.timestamps.tolist() == whole.timestamps.tolist()
    assert [recording[i].depth_timestamp for i in range(4)] == whole.timestamps[shown].tolist()
    assert "1 of 4 colour images have no depth image of their own" in caplog.text


def test_depth_images_of_another_rate_than_the_video(tmp_path: Path) -> None:
    video, images = tmp_path / "rgb.mp4", [tmp_path / f"{i}.png" for i in range(60)]
    every_second = paired_by_number(video, 30, {float(i): images[i] for i in range(0, 30, 2)})  # numbered as the frames
    assert np.flatnonzero(every_second.has_depth).tolist() == list(range(0, 30, 2)) and every_second.files[6] == (video, images[6])
    assert every_second.numbers == list(range(30))
    one_more = paired_by_number(video, 30, {float(i): images[i] for i in range(1, 32)})
    assert one_more.places.tolist() == list(range(30)) and one_more.files[0] == (video, images[1])
    with pytest.raises(RecordingError, match=r"30 frames in rgb\.mp4 and 10 images in depth/, expected one depth image for each frame"):
        paired_by_number(video, 30, {float(i): images[i] for i in range(10)})


def test_two_videos(tmp_path: Path) -> None:
    path = write_video_folder(tmp_path / "room")
    write_video(path / "video.avi", codec="mpeg4")
    with pytest.raises(RecordingError, match=r"2 colour videos \(rgb\.mp4, video\.avi\), expected one"):
        open_recording(path)


def test_a_depth_image_that_is_missing(tmp_path: Path) -> None:
    path = write_video_folder(tmp_path / "room")
    recording = open_recording(path)
    (path / "depth/0008.png").unlink()
    with pytest.raises(FrameError, match=r"0008\.png: No such file"):
        recording[1]
    assert recording[2].index == 2


def test_a_folder_without_a_video(tmp_path: Path) -> None:
    (tmp_path / "depth").mkdir()
    with pytest.raises(RecordingError, match=r"expected a video rgb\.mp4 .* and the folder depth/"):
        open_recording(tmp_path, format="video")
