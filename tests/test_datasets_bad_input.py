"""Wrong and damaged recordings: one clear line each, at opening for the whole recording, at the frame for a single one."""

import json
import re
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from helpers.recordings import (
    HEIGHT,
    WIDTH,
    colour_image,
    depth_image,
    pose,
    write_folder,
    write_icl_nuim,
    write_replica,
    write_scannet,
    write_sens,
    write_seven_scenes,
    write_tum,
)
from idfslam.datasets import open_recording
from idfslam.datasets.provenance import is_guessed
from idfslam.errors import ConfigError, FrameError, RecordingError
from idfslam.geometry.camera import Camera


def refuses(path: Path, message: str, **arguments: object) -> None:
    """Opening raises RecordingError with one line that matches."""
    with pytest.raises(RecordingError, match=message) as caught:
        open_recording(path, **arguments)  # type: ignore[arg-type]
    assert "\n" not in str(caught.value)


def warns(path: Path, message: str, caplog: pytest.LogCaptureFixture, **arguments: object) -> np.ndarray | None:
    """Opening gives one warning of one line that matches, and the ground truth that is returned."""
    caplog.clear()
    truth = open_recording(path, **arguments).ground_truth  # type: ignore[arg-type]
    assert len(caplog.messages) == 1 and "\n" not in caplog.text.strip()
    assert re.search(message, caplog.messages[0]), caplog.messages[0]
    return truth


def write_depth(path: Path, image: np.ndarray) -> None:
    assert cv2.imwrite(str(path), image)


# ----- one bad frame in a recording


def absurd_size(path: Path) -> None:
    """A PNG header of 2^31 - 1 pixels a side, its checksum in order, over the same pixels."""
    data = path.read_bytes()
    header = b"IHDR" + struct.pack(">2I", 2**31 - 1, 2**31 - 1) + data[24:29]
    path.write_bytes(data[:12] + header + struct.pack(">I", zlib.crc32(header)) + data[33:])


def absurd_end(path: Path) -> None:
    """A PNG whose last chunk, which is empty, states a length of 3.5 GB."""
    path.write_bytes(path.read_bytes()[:-12] + struct.pack(">I", 3_500_000_000) + b"IEND\xaeB`\x82")


def cut_off(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-20])


DAMAGE: dict[str, tuple[str, Callable[[Path], None], str]] = {
    "depth missing": ("depth", Path.unlink, "No such file"),
    "colour empty": ("rgb", lambda path: path.write_bytes(b""), "empty"),
    "colour cut off": ("rgb", cut_off, "cut off"),
    "depth cut off": ("depth", cut_off, "cut off"),
    "colour no image": ("rgb", lambda path: path.write_bytes(b"not an image"), "not a readable image"),
    "colour absurd": ("rgb", absurd_size, r"\d+x\d+ pixels"),
    "colour's end absurd": ("rgb", absurd_end, "cut off"),
    "depth 8-bit": (
        "depth",
        lambda path: write_depth(path, np.full((HEIGHT, WIDTH), 9, np.uint8)),
        "8-bit.*expected one channel of 16",
    ),
    "depth is colour": ("depth", lambda path: write_depth(path, colour_image(0)), "colour image, expected 16-bit depth.*swapped"),
    "colour is depth": ("rgb", lambda path: write_depth(path, depth_image(1000)), "16-bit grey image, expected colour.*swapped"),
    "depth size": ("depth", lambda path: write_depth(path, depth_image(1000, (8, 5))), "colour 16x12 and depth 8x5, expected one size"),
}


WITHOUT_DEPTH: dict[str, tuple[str, Callable[[Path], None], str]] = {
    "no depth": ("depth", lambda path: write_depth(path, np.zeros((HEIGHT, WIDTH), np.uint16)), "no depth .all zero"),
    "all invalid": ("depth", lambda path: write_depth(path, np.full((HEIGHT, WIDTH), 65535, np.uint16)), "no depth"),
}


@pytest.mark.parametrize("name", DAMAGE)
@pytest.mark.parametrize("frame", [0, 3])
def test_a_single_bad_frame_is_a_frame_error(name: str, frame: int, tmp_path: Path) -> None:
    """In the middle and as the very first."""
    path, (folder, damage, message) = write_folder(tmp_path / "room", frames=6, suffix="png"), DAMAGE[name]
    recording = open_recording(path)
    damage(path / folder / f"{frame:06d}.png")
    if name != "depth missing":  # then it is a frame without depth
        recording = open_recording(path)
    with pytest.raises(FrameError, match=message) as caught:
        recording[frame]
    assert "\n" not in str(caught.value)
    assert recording[1].index == 1 and recording[5].index == 5


@pytest.mark.parametrize("name", WITHOUT_DEPTH)
@pytest.mark.parametrize("frame", [0, 3])
def test_a_frame_without_a_reading_is_a_frame_without_depth(name: str, frame: int, tmp_path: Path) -> None:
    path, (folder, damage, _) = write_folder(tmp_path / "room", frames=6, suffix="png"), WITHOUT_DEPTH[name]
    damage(path / folder / f"{frame:06d}.png")
    shown = open_recording(path)[frame]
    assert not shown.depth.any() and round(float(shown.colour[0, 0, 0]) * 255) == 10 + frame


@pytest.mark.parametrize("name", [*DAMAGE, *WITHOUT_DEPTH])
def test_the_same_in_every_frame_is_a_recording_error(name: str, tmp_path: Path) -> None:
    path, (folder, damage, message) = write_folder(tmp_path / "room", suffix="png"), (DAMAGE | WITHOUT_DEPTH)[name]
    for file in (path / folder).iterdir():
        damage(file)
    refuses(path, "3 colour images, but no depth images" if name == "depth missing" else message)


def test_a_frame_of_another_size_is_a_frame_error(tmp_path: Path) -> None:
    path = write_folder(tmp_path / "room", suffix="png")
    write_depth(path / "rgb/000001.png", colour_image(1, (8, 6)))
    write_depth(path / "depth/000001.png", depth_image(1000, (8, 6)))
    with pytest.raises(FrameError, match="frame 1 is 8x6, expected the recording's 16x12"):
        open_recording(path)[1]


def test_a_listed_file_that_is_missing_is_left_out(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = write_tum(tmp_path / "room")
    (path / "rgb/100.033333.png").unlink()
    truth = warns(path, r"rgb\.txt: 1 image is left out: line 3: .*rgb/100\.033333\.png does not exist", caplog)
    assert truth is not None and truth[:, 0, 3] == pytest.approx([0.0, 0.4])
    assert open_recording(path).timestamps == pytest.approx([100.0, 100.066667])


# ----- the recording as a whole


def test_no_such_path(tmp_path: Path) -> None:
    refuses(tmp_path / "absent", "no such file or folder")


def test_files_that_cannot_be_read_or_are_no_text(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = write_tum(tmp_path / "room")
    (path / "groundtruth.txt").write_bytes(bytes(range(256)))
    assert warns(path, r"groundtruth\.txt.*expected.*: the run has no ground truth", caplog) is None
    (path / "rgb.txt").write_bytes(b"\xff\xfe1\x01")
    refuses(path, r"rgb\.txt: line 1|rgb\.txt: empty")
    scene = write_scannet(tmp_path / "scene")
    (scene / "pose/1.txt").unlink()
    (scene / "pose/1.txt").mkdir()
    truth = warns(scene, r"pose/1\.txt: Is a directory: 2 of 3 frames have ground truth", caplog)
    assert truth is not None and np.isfinite(truth).all((1, 2)).tolist() == [True, False, True]


def test_unknown_layout(tmp_path: Path) -> None:
    refuses(tmp_path, "found an empty folder, expected one of scannet .*folder")
    (tmp_path / "video.mp4").write_bytes(b"")
    refuses(tmp_path, r"found video\.mp4")
    refuses(tmp_path / "video.mp4", r"a video without depth, expected a folder with it as rgb\.mp4 and with depth images in depth/")
    (tmp_path / "notes.pdf").write_bytes(b"")
    refuses(tmp_path / "notes.pdf", "found a file")


@pytest.mark.parametrize("format", ["folder", "tum", "replica", "7scenes", "scannet", "icl_nuim"])
def test_a_format_that_the_folder_does_not_have(format: str, tmp_path: Path) -> None:
    refuses(tmp_path, "expected|missing", format=format)


def test_empty_folders(tmp_path: Path) -> None:
    (tmp_path / "rgb").mkdir()
    (tmp_path / "depth").mkdir()
    refuses(tmp_path, "no numbered images")
    (tmp_path / "rgb.txt").write_text("# nothing\n")
    (tmp_path / "depth.txt").write_text("# nothing\n")
    refuses(tmp_path, r"rgb\.txt: empty")


def test_a_depth_image_without_a_partner_is_left_out_and_the_others_keep_time_and_pose(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = write_folder(tmp_path / "room", suffix="png")
    (path / "rgb/000001.png").unlink()
    truth = warns(path, "room: 1 image is left out: depth/000001.png has no partner of the same number", caplog)
    recording = open_recording(path)
    assert len(recording) == 2 and recording.timestamps == pytest.approx([0, 2 / 30])
    assert round(float(recording[1].colour[0, 0, 0]) * 255) == 12  # red of image 2
    assert truth is not None and truth[:, 0, 3] == pytest.approx([0.0, 0.4])
    np.savetxt(path / "traj.txt", np.stack([pose(i).ravel() for i in range(3)]))
    for file in (path / "pose").iterdir():
        file.unlink()
    (path / "pose").rmdir()
    truth = open_recording(path).ground_truth
    assert truth is not None and truth[:, 0, 3] == pytest.approx([0.0, 0.4])


def test_a_colour_image_without_a_partner_is_a_frame_without_depth(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Nobody states stamps, so that no other depth image is known to be near in time."""
    path = write_folder(tmp_path / "room", suffix="png")
    (path / "depth/000001.png").unlink()
    truth = warns(path, "room: 1 of 3 colour images have no depth image of their own; they take the nearest in time, or have no", caplog)
    recording = open_recording(path)
    assert recording.timestamps == pytest.approx([0, 1 / 30, 2 / 30])
    assert [frame.depth.any() for frame in (recording[0], recording[1], recording[2])] == [True, False, True]
    assert recording[1].depth_timestamp == recording[1].timestamp
    assert truth is not None and truth[:, 0, 3] == pytest.approx([0.0, 0.2, 0.4])
    for file in (path / "pose").iterdir():
        file.unlink()
    (path / "pose").rmdir()
    for rows, expected in (((0, 1, 2), [0.0, 0.2, 0.4]), ((0, 2), [0.0, np.nan, 0.4])):  # of all frames; of those with depth
        np.savetxt(path / "traj.txt", np.stack([pose(i).ravel() for i in rows]))
        truth = open_recording(path).ground_truth
        assert truth is not None and truth[:, 0, 3] == pytest.approx(expected, nan_ok=True)


def test_many_images_without_a_partner_are_one_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = write_folder(tmp_path / "room", frames=40)
    for i in range(2, 40):
        (path / f"depth/{i:06d}.png").unlink()
    warns(path, "room: 38 of 40 colour images have no depth image of their own", caplog)
    (path / "depth/000000.png").unlink()
    (path / "depth/000001.png").rename(path / "depth/000099.png")
    refuses(path, r"40 colour and 1 depth images, none with a partner .the first is rgb/000000\.jpg.: expected pairs of equal numbers")


def test_two_images_of_one_number(tmp_path: Path) -> None:
    path = write_folder(tmp_path / "room")
    write_depth(path / "rgb/000001.png", colour_image(1))
    refuses(path, "000001.* and .*000001.* have the same number")


def test_swapped_folders(tmp_path: Path) -> None:
    path = write_folder(tmp_path / "room")
    (path / "rgb").rename(path / "tmp")
    (path / "depth").rename(path / "rgb")
    (path / "tmp").rename(path / "depth")
    refuses(path, "a colour image, expected 16-bit depth: are the colour and depth images swapped")


# ----- the camera


def test_an_unknown_camera_is_never_guessed(tmp_path: Path) -> None:
    path = write_folder(tmp_path / "room")
    (path / "intrinsics.txt").unlink()
    refuses(path, "camera is unknown .fx, fy, cx, cy missing.: give cam_params.json in the recording or --camera.fx")
    refuses(path, "camera is unknown .cy missing", camera={"fx": 15.0, "fy": 15.0, "cx": 7.0})
    refuses(write_tum(tmp_path / "desk", cam_params=False), "camera is unknown")


def test_an_unknown_camera_may_start_from_its_field_of_view(tmp_path: Path) -> None:
    path = write_folder(tmp_path / "room")
    known = open_recording(path).camera
    assert open_recording(path, camera={"field_of_view": 90.0}).camera == known  # what the recording states is no guess
    assert not is_guessed(open_recording(path, camera={"field_of_view": 90.0}))
    (path / "intrinsics.txt").unlink()
    refuses(path, "start from --camera.guess")
    recording = open_recording(path, camera={"field_of_view": 90.0})
    found, half = recording.camera, known.width / 2
    assert found == Camera(known.width, known.height, found.fx, found.fy, half - 0.5, known.height / 2 - 0.5)
    assert (found.fx, found.fy) == pytest.approx((half, half))
    assert is_guessed(recording)
    with pytest.raises(ConfigError, match="field of view 200, expected 10 to 140 degrees"):
        open_recording(path, camera={"field_of_view": 200.0})
    with pytest.raises(ConfigError, match="field of view nan, expected 10 to 140 degrees"):
        open_recording(write_folder(tmp_path / "known"), camera={"field_of_view": float("nan")})
    with pytest.raises(RecordingError, match=r"unknown .fy, cx, cy missing.: .*, or give none of them, so that the camera is guessed"):
        open_recording(path, camera={"field_of_view": 60.0, "fx": 100.0})


def test_published_values_hold_for_the_published_size_only(tmp_path: Path) -> None:
    for write in (write_replica, write_seven_scenes, write_icl_nuim):
        path = write(tmp_path / write.__name__, cam_params=False)
        refuses(path, r"images are 16x12, but the published camera of .* is for (1200x680|640x480)")


def test_cam_params_of_another_size(tmp_path: Path) -> None:
    path = write_replica(tmp_path / "room0")
    values = json.loads((path / "cam_params.json").read_text())
    values["camera"]["w"] = 1200
    (path / "cam_params.json").write_text(json.dumps(values))
    refuses(path, "images are 16x12, but .*cam_params.json is for 1200x12")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "is not JSON .* expected"),
        ("[]", "expected"),
        ('{"camera": 5}', "expected"),
        ('{"camera": {"fx": 1}}', "no 'fy', expected"),
        ('{"camera": {"fx": "a", "fy": 1, "cx": 1, "cy": 1}}', "expected"),
        ('{"camera": {"fx": 15, "fy": -15, "cx": 7, "cy": 5, "scale": 1000}}', "expected finite numbers with fx and fy above 0"),
        (
            '{"camera": {"fx": 1e300, "fy": 15, "cx": 7, "cy": 5, "scale": 1000}}',
            r"says fx 1e\+300, .* a view of no degree, expected focal lengths",
        ),
        ('{"camera": {"fx": NaN, "fy": 15, "cx": 7, "cy": 5, "scale": 1000}}', "expected finite numbers"),
        ('{"camera": {"fx": 15, "fy": 15, "cx": 70, "cy": 5, "scale": 1000}}', "principal point .* outside the 16x12 images"),
        ('{"camera": {"fx": 15, "fy": 15, "cx": 7, "cy": 5, "scale": 0}}', "depth scale is 0.0, expected units per metre above 0"),
        ('{"camera": {"fx": 15, "fy": 15, "cx": 7, "cy": 5, "distortion": [1]}}', "1 distortion values, expected k1 k2 p1 p2"),
    ],
)
def test_bad_cam_params(text: str, message: str, tmp_path: Path) -> None:
    path = write_folder(tmp_path / "room")
    (path / "cam_params.json").write_text(text)
    refuses(path, message)


@pytest.mark.parametrize("text", ["15 0 7\n0 15 5\n", "a b c d\n", "", "15 1 7\n0 15 5\n0 0 1\n"])
def test_bad_intrinsics(text: str, tmp_path: Path) -> None:
    path = write_folder(tmp_path / "room")
    (path / "intrinsics.txt").write_text(text)
    refuses(path, r"intrinsics\.txt.*expected")


# ----- poses: no fault in them stops a run


def test_nan_poses(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = write_folder(tmp_path / "room")
    np.savetxt(path / "pose/000001.txt", np.full((4, 4), np.nan))
    truth = open_recording(path).ground_truth
    assert truth is not None and np.isnan(truth[1]).all() and np.isfinite(truth[2]).all() and not caplog.messages
    for i in range(3):
        np.savetxt(path / f"pose/{i:06d}.txt", np.full((4, 4), np.nan))
    assert warns(path, "room/pose: none of the 3 poses is finite: the run has no ground truth", caplog) is None


@pytest.mark.parametrize("change", ["scaled", "mirrored", "bottom row"])
def test_poses_that_are_not_rigid(change: str, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = write_folder(tmp_path / "room")
    T = pose(2)
    if change == "scaled":
        T[:3, :3] *= 1.1
    elif change == "mirrored":
        T[:3, 0] *= -1
    else:
        T[3, 0] = 0.5
    np.savetxt(path / "pose/000002.txt", T)
    truth = warns(path, "room/pose: the pose of frame 2 is not a rigid transform: 2 of 3 frames have ground truth", caplog)
    assert truth is not None and np.isfinite(truth).all((1, 2)).tolist() == [True, True, False]


def test_mismatched_and_malformed_poses(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = write_folder(tmp_path / "room")
    for text, message in (
        ("1 0 0\n", r"000001\.txt: 3 numbers, expected a 4x4"),
        ("one\n", "could not convert.*expected numbers"),
        (None, "room/pose: no pose for frame 1"),
    ):
        (path / "pose/000001.txt").unlink() if text is None else (path / "pose/000001.txt").write_text(text)
        truth = warns(path, f"{message}.*: 2 of 3 frames have ground truth", caplog)
        assert truth is not None and np.isnan(truth[1]).all() and truth[2, 0, 3] == 0.4
    replica = write_replica(tmp_path / "room0")
    np.savetxt(replica / "traj.txt", np.stack([pose(i).ravel() for i in range(2)]))
    assert warns(replica, r"traj\.txt: 2 poses for 3 frames, expected one for each: the run has no ground truth", caplog) is None
    (replica / "traj.txt").write_text("1 0 0\n")
    assert warns(replica, r"traj\.txt:1: 3 values; expected .*: the run has no ground truth", caplog) is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("# nothing\n", "no poses in it"),
        ("100.0 1 2 3\n", ":1: |1 lines of 4 values"),
        ("100.0 1 2 3 0 0 0 2\n", ":1: the quaternion's norm is 2; expected 1"),
        ("500.0 1 2 3 0 0 0 1\n", "no pose within 20 ms of an image"),
        ("100.0 nan 2 3 0 0 0 1\n", ":1: a value is not finite"),
        ("1 0 0 0 0 1 0 0 0 0 1 0\n", "poses without stamps"),
    ],
)
def test_bad_tum_ground_truth(text: str, message: str, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = write_tum(tmp_path / "room")
    (path / "groundtruth.txt").write_text(text)
    assert warns(path, f"groundtruth.txt.*({message}).*: the run has no ground truth", caplog) is None
    caplog.clear()
    assert open_recording(path, truth=False).ground_truth is None and not caplog.messages


def test_bad_tum_lists(tmp_path: Path) -> None:
    path = write_tum(tmp_path / "room")
    (path / "depth.txt").write_text("500.0 depth/100.000000.png\n")
    refuses(path, "no colour and depth image within 20 ms")
    (path / "depth.txt").write_text("depth/100.000000.png\n")
    refuses(path, r"depth\.txt: line 1 is 'depth/100.000000.png', expected a stamp in seconds and a file")


def test_bad_icl_nuim_files(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = write_icl_nuim(tmp_path / "living_room_traj0")
    (path / "other.gt.freiburg").write_text("0 0 0 0 0 0 0 1")
    assert warns(path, "2 files .*expected one.*: the run has no ground truth", caplog) is None
    (path / "other.gt.freiburg").unlink()
    (path / "associations.txt").write_text("0 depth/0.png 1 rgb/1.png")
    refuses(path, "line 1 is .*expected: number depth/N.png number rgb/N.png")
    (path / "associations.txt").write_text("")
    refuses(path, r"associations\.txt: empty")


# ----- .sens


def test_bad_sens_files(tmp_path: Path) -> None:
    path = write_sens(tmp_path / "scene.sens")
    data = path.read_bytes()
    path.write_bytes(struct.pack("<I", 3) + data[4:])
    refuses(path, ".sens version 3, expected 4")
    path.write_bytes(data[:100])
    refuses(path, "cut off in its header")
    path.write_bytes(data[:-1])
    refuses(path, "cut off in frame 2 of 3")
    path.write_bytes(b"")
    refuses(path, "cut off in its header")
    refuses(write_sens(tmp_path / "b.sens", depth_codec="occi"), "depth compression 2, expected")
    refuses(tmp_path, "2 .sens files, expected .* one .sens file: name one")


def test_scannet_without_the_depth_camera(tmp_path: Path) -> None:
    path = write_scannet(tmp_path / "scene0000_00", cam_params=False)
    (path / "intrinsic/intrinsic_depth.txt").unlink()
    refuses(path, "camera is unknown")
