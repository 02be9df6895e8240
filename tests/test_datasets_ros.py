"""ROS 1, ROS 2 and MCAP: topics, encodings, stamps, cameras, transforms, poses; RealSense's bags; and what is wrong in one line."""

import shutil
import sqlite3
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode

from helpers.recordings import HEIGHT, WIDTH, colour_image, depth_image, pose
from helpers.ros_bags import (
    COLOUR,
    DEPTH,
    INFO,
    Recorded,
    camera_info,
    compressed,
    compressed_depth,
    float32,
    image,
    pose_message,
    recorded,
    text,
    tf,
    transform,
    write_bag,
)
from idfslam.config import FAST
from idfslam.datasets import open_recording
from idfslam.errors import ConfigError, FrameError, RecordingError
from idfslam.geometry.camera import Camera
from idfslam.runs.run_config import RecordingSource, read_config, write_config
from idfslam.runs.source import open_source

STORAGES = ("ros1", "sqlite3", "mcap")
CAMERA = Camera(WIDTH, HEIGHT, 15.0, 15.0, 7.5, 5.5)


def bag(tmp_path: Path, messages: Recorded, storage: str = "ros1", **options: object) -> Path:
    return write_bag(tmp_path / ("room.bag" if storage == "ros1" else "room"), messages, storage, **options)


def check(frame: object, i: int, *, atol: float = 0.1) -> None:
    """Frame i of `recorded`: depth 1 m + i mm."""
    np.testing.assert_allclose(frame.colour[6, 8] * 255, [10 + i, 51, 102], atol=atol)  # type: ignore[attr-defined]
    np.testing.assert_allclose(frame.depth[6, 8], 1 + i / 1000, atol=1e-4)  # type: ignore[attr-defined]
    assert frame.depth[0, 0] == 0  # type: ignore[attr-defined]


@pytest.mark.parametrize("storage", STORAGES)
def test_every_storage(storage: str, tmp_path: Path) -> None:
    recording = open_recording(bag(tmp_path, recorded(), storage))
    assert len(recording) == 3 and recording.name == "room" and recording.ground_truth is None
    assert recording.camera == CAMERA
    np.testing.assert_allclose(recording.timestamps, 100 + np.arange(3) / 30, atol=1e-6)
    for i in (0, 1, 2, 0, 2, 1):
        check(recording[i], i)


def test_an_mcap_file_alone(tmp_path: Path) -> None:
    folder = bag(tmp_path, recorded(), "mcap")
    shutil.copy(next(folder.glob("*.mcap")), tmp_path / "alone.mcap")
    recording = open_recording(tmp_path / "alone.mcap")
    assert recording.name == "alone"
    check(recording[2], 2)
    (tmp_path / "folder").mkdir()
    (tmp_path / "alone.mcap").rename(tmp_path / "folder/alone.mcap")
    check(open_recording(tmp_path / "folder")[1], 1)


@pytest.mark.parametrize(
    ("storage", "options"),
    [
        ("ros1", {"set_compression": (Writer1.CompressionFormat.LZ4,)}),
        ("ros1", {"set_compression": (Writer1.CompressionFormat.BZ2,)}),
        ("mcap", {"set_compression": (CompressionMode.STORAGE, CompressionFormat.ZSTD)}),
        ("sqlite3", {"set_compression": (CompressionMode.MESSAGE, CompressionFormat.ZSTD)}),
        ("sqlite3", {"set_compression": (CompressionMode.FILE, CompressionFormat.ZSTD)}),
    ],
)
def test_compressed_bags(storage: str, options: dict, tmp_path: Path) -> None:
    recording = open_recording(bag(tmp_path, recorded(), storage, **options))
    for i in (2, 0, 1):
        check(recording[i], i)


def encoded(encoding: str) -> np.ndarray:
    """Frame 1 in an encoding."""
    bgr = colour_image(1)
    grey = np.full((HEIGHT, WIDTH), 77, np.uint8)
    yuv = [[24.966, 128.553, 65.481], [112.0, -74.203, -37.797], [-18.214, -93.786, 112.0]] @ bgr[0, 0] / 255.0  # ITU-R BT.601
    y, cb, cr = np.round(yuv + np.array([16, 128, 128])).astype(np.uint8)
    return {
        "bgr8": bgr,
        "8UC3": bgr,
        "rgb8": bgr[..., ::-1],
        "bgra8": cv2.cvtColor(bgr, cv2.COLOR_BGR2BGRA),
        "rgba8": cv2.cvtColor(bgr, cv2.COLOR_BGR2RGBA),
        "mono8": grey,
        "yuv422": np.tile(np.array([[cb, y], [cr, y]], np.uint8), (HEIGHT, WIDTH // 2, 1)),
        "yuv422_yuy2": np.tile(np.array([[y, cb], [y, cr]], np.uint8), (HEIGHT, WIDTH // 2, 1)),
        "bayer_rggb8": np.tile(np.array([[11, 51], [51, 102]], np.uint8), (HEIGHT // 2, WIDTH // 2)),
        "bayer_gbrg8": np.tile(np.array([[51, 102], [11, 51]], np.uint8), (HEIGHT // 2, WIDTH // 2)),
    }[encoding]


@pytest.mark.parametrize("pad", [0, 5])
@pytest.mark.parametrize(
    "encoding", ["bgr8", "8UC3", "rgb8", "bgra8", "rgba8", "mono8", "yuv422", "yuv422_yuy2", "bayer_rggb8", "bayer_gbrg8"]
)
def test_encodings_of_colour(encoding: str, pad: int, tmp_path: Path) -> None:
    messages = [(INFO, 1.0, camera_info()), (DEPTH, 1.0, image(depth_image(1000), "16UC1", 1.0, pad=pad))]
    messages.append((COLOUR, 1.0, image(encoded(encoding), encoding, 1.0, pad=pad)))
    frame = open_recording(bag(tmp_path, messages))[0]
    expected = [77, 77, 77] if encoding == "mono8" else [11, 51, 102]
    np.testing.assert_allclose(frame.colour[6, 8] * 255, expected, atol=2 if "yuv" in encoding else 0.1)
    assert frame.depth[6, 8] == 1 and frame.depth[0, 0] == 0


def jpeg(i: int, form: str = ".jpg") -> bytes:
    return cv2.imencode(form, colour_image(i))[1].tobytes()


DEPTHS: dict[str, Callable[[], tuple[str, object]]] = {
    "16UC1": lambda: ("", image(depth_image(2000), "16UC1", 1.0)),
    "mono16": lambda: ("", image(depth_image(2000), "mono16", 1.0)),
    "32FC1": lambda: ("", image(np.where(depth_image(1) > 0, 2.0, np.nan).astype(np.float32), "32FC1", 1.0)),
    "16UC1 png": lambda: ("/compressed", compressed(cv2.imencode(".png", depth_image(2000))[1].tobytes(), "16UC1; png compressed ", 1.0)),
    "16UC1 compressedDepth": lambda: ("/compressedDepth", compressed_depth(depth_image(1) * 2.0, 1.0, encoding="16UC1")),
    "32FC1 compressedDepth": lambda: ("/compressedDepth", compressed_depth(depth_image(1) * 2.0, 1.0, encoding="32FC1")),
}


@pytest.mark.parametrize("storage", ["ros1", "mcap"])
@pytest.mark.parametrize("name", DEPTHS)
def test_encodings_of_depth(name: str, storage: str, tmp_path: Path) -> None:
    """2 m, and no reading in the first pixel."""
    suffix, message = DEPTHS[name]()
    messages = [(INFO, 1.0, camera_info()), (COLOUR + "/compressed", 1.0, compressed(jpeg(0), "rgb8; jpeg compressed bgr8", 1.0))]
    recording = open_recording(bag(tmp_path, [*messages, (DEPTH + suffix, 1.0, message)], storage))
    assert recording.camera == CAMERA  # by the camera_info beside image_raw, of which /compressed is a transport
    frame = recording[0]
    np.testing.assert_allclose(frame.depth[6, 8], 2, atol=1e-3)
    assert frame.depth[0, 0] == 0 and np.count_nonzero(frame.depth == 0) == 1
    np.testing.assert_allclose(frame.colour[6, 8] * 255, [10, 51, 102], atol=2.5)


def test_depth_of_the_other_order_of_bytes(tmp_path: Path) -> None:
    def swapped(store: object) -> object:
        message = image(depth_image(1000).byteswap(), "16UC1", 1.0)(store)
        message.is_bigendian = 1
        return message

    messages = [(INFO, 1.0, camera_info()), (COLOUR, 1.0, image(colour_image(0), "bgr8", 1.0)), (DEPTH, 1.0, swapped)]
    assert open_recording(bag(tmp_path, messages))[0].depth[6, 8] == 1


def test_pairs_go_by_the_stamps_of_the_headers(tmp_path: Path) -> None:
    """Depth is stamped 5 ms later and arrives a whole frame late; one colour image has no depth of its own."""
    messages = [entry if entry[0] != DEPTH else (DEPTH, entry[1] + 1 / 30, entry[2]) for entry in recorded(4, late=0.005)]
    messages = [entry for entry in messages if not (entry[0] == DEPTH and abs(entry[1] - (100 + 3 / 30 + 0.025)) < 1e-6)]
    recording = open_recording(bag(tmp_path, messages, "mcap"))
    np.testing.assert_allclose(recording.timestamps, 100 + np.arange(4) / 30, atol=1e-6)
    lags = [recording[i].depth_lag for i in range(4)]
    np.testing.assert_allclose(lags, [0.005, 0.005, 0.005 - 1 / 30, 0.005], atol=1e-6)  # the third has the depth of the second
    for i in (0, 1, 3):
        check(recording[i], i)


def test_images_without_stamps_go_by_their_arrival(tmp_path: Path) -> None:
    messages: Recorded = [(INFO, 1.0, camera_info())]
    for i in range(2):
        messages += [(COLOUR, 5.0 + i, image(colour_image(i), "bgr8", 0.0)), (DEPTH, 5.01 + i, image(depth_image(1000 + i), "16UC1", 0.0))]
    recording = open_recording(bag(tmp_path, messages, "sqlite3"))
    assert recording.timestamps.tolist() == [5.0, 6.0]
    check(recording[1], 1)


def test_named_topics(tmp_path: Path) -> None:
    """Two cameras that fit equally well: the message names them, and so may the user."""
    messages: Recorded = []
    for k, name in enumerate("ab"):
        messages += [(f"/{name}/camera_info", 1.0, camera_info(K=(15 + k, 15, 7.5, 5.5), frame=name))]
        messages += [(f"/{name}/image", 1.0, image(colour_image(k), "bgr8", 1.0, name))]
        messages += [(f"/{name}/depth", 1.0, image(depth_image(1000 + k), "16UC1", 1.0, name))]
    path = bag(tmp_path, messages)
    with pytest.raises(RecordingError, match="/a/image with /a/depth or /b/image with /b/depth fit equally well: name them with --topics"):
        open_recording(path)
    recording = open_recording(path, topics={"colour": "/b/image", "depth": None})
    check(recording[0], 1)
    assert recording.camera.fx == 16
    named = {"colour": "a/image", "depth": "/a/depth", "camera_info": "/b/camera_info"}
    recording = open_recording(path, topics=named)
    check(recording[0], 0)
    assert recording.camera.fx == 16


def test_colour_before_grey_raw_before_compressed_registered_before_not(tmp_path: Path) -> None:
    messages = recorded()
    for stamp in (100.0, 100 + 1 / 30):
        messages.append(("/camera/infra1/image_rect_raw", stamp, image(np.zeros((9, 9), np.uint8), "mono8", stamp, "infra1")))
        messages.append((COLOUR + "/compressed", stamp, compressed(b"never decoded", "jpeg", stamp)))
        messages.append(("/camera/depth/image_rect_raw", stamp, image(np.ones((9, 9), np.uint16), "16UC1", stamp, "depth")))
    recording = open_recording(bag(tmp_path, messages))
    assert len(recording) == 3
    check(recording[2], 2)


def test_distortion_and_rectified_images(tmp_path: Path) -> None:
    """Raw images go by K and are undistorted, rectified ones by P."""
    info = camera_info(K=(15, 15, 7.5, 5.5), d=(-0.3, 0.0, 0.0, 0.0, 0.0), P=(14, 14, 7, 5))
    depth = (DEPTH, 1.0, image(depth_image(1000), "16UC1", 1.0))
    raw = open_recording(bag(tmp_path / "raw", [(INFO, 1.0, info), depth, (COLOUR, 1.0, image(colour_image(0), "bgr8", 1.0))]))
    assert raw.camera == CAMERA and raw[0].depth[0, 0] == 1  # the pixel without reading has gone outwards
    colour = ("/camera/color/image_rect_color", 1.0, image(colour_image(0), "bgr8", 1.0))
    rectified = open_recording(bag(tmp_path / "rectified", [(INFO, 1.0, info), depth, colour]))
    assert rectified.camera == Camera(WIDTH, HEIGHT, 14.0, 14.0, 7.0, 5.0) and rectified[0].depth[0, 0] == 0


def baseline(x: float) -> np.ndarray:
    T = np.eye(4)
    T[0, 3] = x
    return T


def with_depth_beside(frames: tuple[tuple[str, str, np.ndarray], ...], *, info: bool = True) -> Recorded:
    """Depth, twice as coarse, of a camera in a frame of its own."""
    messages: Recorded = [("/tf_static", 1.0 + k / 100, tf(*frame)) for k, frame in enumerate(frames)]
    messages += [(INFO, 1.0, camera_info(frame="colour")), (COLOUR, 1.0, image(colour_image(0), "bgr8", 1.0, "colour"))]
    messages += [("/camera/depth/image_rect_raw", 1.0, image(depth_image(1000, (8, 6)), "16UC1", 1.0, "depth"))]
    return [*messages, *([("/camera/depth/camera_info", 1.0, camera_info(K=(7.5, 7.5, 3.5, 2.5), size=(8, 6), frame="depth"))] * info)]


@pytest.mark.parametrize("storage", ["ros1", "mcap"])
def test_depth_is_registered_by_tf_static(storage: str, tmp_path: Path) -> None:
    """Depth stands 1/3 - 1/5 = 2/15 m to the right of colour: 15 px * 2/15 m / 1 m = 2 px."""
    frames = (("link", "depth", baseline(1 / 3)), ("link", "colour", baseline(1 / 5)))
    frame = open_recording(bag(tmp_path, with_depth_beside(frames), storage))[0]
    assert frame.depth.shape == (HEIGHT, WIDTH)
    assert (frame.depth[:, :2] == 0).all() and (frame.depth[:2, 2:4] == 0).all()  # beyond its edge; its first pixel, now 2 x 2
    np.testing.assert_allclose(frame.depth[2:, 2:], 1, rtol=1e-6)


def test_a_transform_that_is_none(tmp_path: Path) -> None:
    def broken(store: object) -> object:
        message = tf("link", "depth", np.eye(4))(store)
        message.transforms[0].transform.rotation.w = 0.0
        return message

    with pytest.raises(RecordingError, match="/tf_static: depth: a quaternion has length 0, expected 1 in a transform"):
        open_recording(bag(tmp_path, [("/tf_static", 1.0, broken), *with_depth_beside(())]))


def test_depth_whose_pose_is_unknown(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    depth = "/camera/depth/image_rect_raw"
    messages = with_depth_beside((("elsewhere", "depth", np.eye(4)),))
    with pytest.raises(RecordingError, match=f"{depth} in frame depth, {COLOUR} in colour, and no /tf_static between: record depth regis"):
        open_recording(bag(tmp_path / "a", messages))
    same = [entry for entry in messages if entry[0] != depth] + [(depth, 1.0, image(depth_image(1000), "16UC1", 1.0, "depth"))]
    recording = open_recording(bag(tmp_path / "b", same), topics={"depth": depth})
    assert f"the pose of {depth} is unknown; it is assumed to be registered to {COLOUR}" in caplog.text
    check(recording[0], 0)
    known = (("link", "depth", np.eye(4)), ("link", "colour", np.eye(4)))
    with pytest.raises(RecordingError, match=f"no sensor_msgs/CameraInfo for {depth}"):
        open_recording(bag(tmp_path / "c", with_depth_beside(known, info=False)))


@pytest.mark.parametrize("storage", ["ros1", "sqlite3"])
def test_poses_are_read_where_they_are_named(storage: str, tmp_path: Path) -> None:
    """Of the camera itself; or of the robot's base, and the camera 1 m before it."""
    T_base_camera = np.array([[0, 0, 1, 1.0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
    messages = [*recorded(), ("/tf_static", 99.0, tf("base", "camera_color_optical_frame", T_base_camera))]
    for i in range(3):
        stamp = 100 + i / 30
        if i < 2:
            messages.append(("/pose", stamp, pose_message(stamp + 0.001, pose(i))))
        messages.append(("/odom", stamp, pose_message(stamp, pose(i) @ np.linalg.inv(T_base_camera), child="base")))
    path = bag(tmp_path, messages, storage)
    assert open_recording(path).ground_truth is None
    truth = open_recording(path, topics={"poses": "/odom"}).ground_truth
    np.testing.assert_allclose(truth, [pose(i) for i in range(3)], atol=1e-9)
    truth = open_recording(path, topics={"poses": "/pose"}).ground_truth
    np.testing.assert_allclose(truth[:2], [pose(i) for i in range(2)], atol=1e-9)
    assert np.isnan(truth[2]).all()
    with pytest.raises(RecordingError, match=r"no poses in /chatter .found /odom, /pose.: name another with --topics.poses"):
        open_recording(path, topics={"poses": "/chatter"})


def test_a_runs_topics_are_found_again(tmp_path: Path) -> None:
    """In config.yaml, for eval."""
    messages = [*recorded(), *(("/pose", 100 + i / 30, pose_message(100 + i / 30, pose(i))) for i in range(3))]
    path, topics = bag(tmp_path, messages), {"colour": COLOUR, "poses": "/pose"}
    write_config(tmp_path, FAST, RecordingSource(str(path), topics=topics))
    _, source = read_config(tmp_path)
    assert source is not None and source.topics == topics
    np.testing.assert_allclose(open_source(source).ground_truth, [pose(i) for i in range(3)], atol=1e-9)


D400 = "/device_0/sensor_0/Depth_0", "/device_0/sensor_1/Color_0"


def realsense(*, extrinsics: bool = True) -> Recorded:
    """As the RealSense SDK writes them: depth with units of 0.2 mm; the reference stream is infrared, halfway between the two."""
    depth, colour = D400
    messages: Recorded = [
        (f"{depth}/info/camera_info", 0.1, camera_info(K=(7.5, 7.5, 3.5, 2.5), size=(8, 6), frame="0")),
        (f"{colour}/info/camera_info", 0.1, camera_info(frame="0")),
        ("/device_0/sensor_0/option/Depth Units/value", 0.1, float32(0.0002)),
        ("/device_0/info", 0.1, text("D435")),
    ]
    if extrinsics:  # points of the reference stream in the stream's own frame
        messages += [(f"{depth}/tf/0", 0.1, transform(baseline(-1 / 15))), (f"{colour}/tf/0", 0.1, transform(baseline(1 / 15)))]
    for i in range(3):
        stamp = 0.2 + i / 30
        messages.append((f"{depth}/image/data", stamp, image(depth_image(5000 + 5 * i, (8, 6)), "mono16", stamp, "0")))
        messages.append((f"{colour}/image/data", stamp, image(colour_image(i)[..., ::-1], "rgb8", stamp, "0")))
        infrared = image(np.zeros((6, 8), np.uint8), "mono8", stamp, "0")
        messages.append(("/device_0/sensor_0/Infrared_1/image/data", stamp, infrared))
    return messages


def test_realsense_bags(tmp_path: Path) -> None:
    """The colour camera stands 2/15 m to the left of the depth camera: 2 px."""
    recording = open_recording(bag(tmp_path, realsense()))
    assert len(recording) == 3 and recording.camera == CAMERA
    np.testing.assert_allclose(recording.timestamps, 0.2 + np.arange(3) / 30, atol=1e-6)
    for i in (1, 0, 2):
        frame = recording[i]
        np.testing.assert_allclose(frame.colour[6, 8] * 255, [10 + i, 51, 102], atol=0.1)
        assert (frame.depth[:, :2] == 0).all() and (frame.depth[:2, 2:4] == 0).all()
        np.testing.assert_allclose(frame.depth[2:, 2:], 1 + i / 1000, rtol=1e-6)
    with pytest.raises(RecordingError, match="/device_0/sensor_1/Color_0/image/data has no extrinsics"):
        open_recording(bag(tmp_path / "other", realsense(extrinsics=False)))


def leaving_out(topic: str) -> Recorded:
    return [entry for entry in recorded() if entry[0] != topic]


@pytest.mark.parametrize("storage", STORAGES)
@pytest.mark.parametrize(
    ("messages", "topics", "message"),
    [
        (leaving_out(INFO), {}, f"no sensor_msgs/CameraInfo for {COLOUR} .found none at all.: name it with --topics.camera-info, or give"),
        (leaving_out(DEPTH), {}, f"no topic of depth images .16UC1 or 32FC1. .found {COLOUR}.: name it with --topics.depth"),
        (leaving_out(COLOUR), {}, "no topic of colour images .found /camera/aligned"),
        ([("/chatter", 1.0, text("hello"))], {}, "no topic of colour images .found no images among 1 topics."),
        (recorded(), {"colour": "/none"}, f"no images in /none .found {DEPTH}, {COLOUR}.: name another with --topics.colour"),
        (recorded(), {"colour": DEPTH}, f"{DEPTH} holds 16UC1, expected rgb8, bgr8"),
        (recorded(), {"depth": COLOUR}, f"{COLOUR} holds rgb8, expected 16UC1 or 32FC1"),
        (recorded(), {"camera_info": "/none"}, f"no sensor_msgs/CameraInfo in /none .found {INFO}."),
        (recorded(late=0.5), {}, "3 images in .* and 3 in .*, none within 20 ms of another, expected stamps of one clock"),
        ([*leaving_out(INFO), (INFO, 99.9, camera_info(d=(0.1,) * 4, model="equidistant"))], {}, "distortion equidistant of 4 values"),
        ([*leaving_out(INFO), (INFO, 99.9, camera_info(size=(8, 6)))], {}, "images are 16x12, but .*camera_info is for 8x6"),
    ],
)
def test_a_recording_that_cannot_be_used(messages: Recorded, topics: dict, message: str, storage: str, tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=message) as caught:
        open_recording(bag(tmp_path, messages, storage), topics=topics)
    assert "\n" not in str(caught.value)


def test_a_camera_that_was_never_calibrated_is_the_users(tmp_path: Path) -> None:
    path = bag(tmp_path, [*leaving_out(INFO), (INFO, 99.9, camera_info(K=(0, 0, 0, 0)))])
    with pytest.raises(RecordingError, match="no sensor_msgs/CameraInfo for"):
        open_recording(path)
    camera = {"fx": 20.0, "fy": 21.0, "cx": 7.0, "cy": 5.0}
    assert open_recording(path, camera=camera).camera == Camera(WIDTH, HEIGHT, 20.0, 21.0, 7.0, 5.0)


@pytest.mark.parametrize("storage", STORAGES)
@pytest.mark.parametrize("name", [b"3ensor_msgs", b"s:\n print()#"[:11]])
def test_a_type_whose_name_is_code_is_refused(name: bytes, storage: str, tmp_path: Path) -> None:
    path = bag(tmp_path, recorded(), storage)
    for file in [path] if path.is_file() else [file for file in path.iterdir() if file.suffix != ".txt"]:
        file.write_bytes(file.read_bytes().replace(b"sensor_msgs", name))
    with pytest.raises(RecordingError, match="not a readable recording") as caught:
        open_recording(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("storage", STORAGES)
def test_a_bag_that_was_cut_off(storage: str, tmp_path: Path) -> None:
    path = bag(tmp_path, recorded(20), storage)
    file = path if path.is_file() else next(file for file in path.iterdir() if file.suffix in (".db3", ".mcap"))
    for size in (file.stat().st_size // 2, 20, 0):
        file.write_bytes(file.read_bytes()[:size])
        with pytest.raises(RecordingError, match=r": copy the recording again|or copy the recording again") as caught:
            open_recording(path)
        assert "\n" not in str(caught.value)


def test_a_bag_whose_data_file_is_missing(tmp_path: Path) -> None:
    path = bag(tmp_path, recorded(), "sqlite3")
    next(path.glob("*.db3")).unlink()
    with pytest.raises(RecordingError, match=r"not a readable recording .Some database files are missing"):
        open_recording(path)


@pytest.mark.parametrize("storage", ["ros1", "mcap"])
def test_one_damaged_image_is_one_frame_lost(storage: str, tmp_path: Path) -> None:
    messages = recorded(5)
    damaged = compressed(jpeg(2)[:-20], "jpeg", 100 + 2 / 30)
    messages = [(INFO, 99.9, camera_info())] + [entry for entry in messages if entry[0] == DEPTH]
    for i in range(5):
        stamp = 100 + i / 30
        messages.append((COLOUR + "/compressed", stamp, damaged if i == 2 else compressed(jpeg(i), "jpeg", stamp)))
    recording = open_recording(bag(tmp_path, messages, storage))
    with pytest.raises(FrameError, match=r"image_raw/compressed at 100\.067 s: cut off .* bytes.: copy the recording again"):
        recording[2]
    check(recording[3], 3, atol=2.5)


def test_a_file_that_shrinks_while_it_is_read(tmp_path: Path) -> None:
    size = (320, 240)
    messages: Recorded = [(INFO, 1.0, camera_info(K=(300, 300, 159.5, 119.5), size=size))]
    for i in range(10):
        messages.append((COLOUR, 1.0 + i, image(colour_image(i, size), "bgr8", 1.0 + i)))
        messages.append((DEPTH, 1.1 + i, image(depth_image(1000, size), "16UC1", 1.0 + i)))
    path = bag(tmp_path, messages)
    recording = open_recording(path)
    with path.open("r+b") as file:
        file.truncate(path.stat().st_size // 3)
    with pytest.raises(FrameError, match=f"{COLOUR} at 9.000 s cannot be read .*: copy the recording again") as caught:
        recording[8]
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("storage", "options"),
    [
        ("ros1", {}),
        ("ros1", {"set_compression": (Writer1.CompressionFormat.LZ4,)}),
        ("ros1", {"set_compression": (Writer1.CompressionFormat.BZ2,)}),
        ("sqlite3", {}),
        ("sqlite3", {"set_compression": (CompressionMode.MESSAGE, CompressionFormat.ZSTD)}),
        ("mcap", {}),
        ("mcap", {"set_compression": (CompressionMode.STORAGE, CompressionFormat.ZSTD)}),
    ],
)
def test_whatever_is_damaged_is_said_in_one_line(storage: str, options: dict, tmp_path: Path) -> None:
    """Bytes overwritten at places spread over the whole file: readable still, or refused, as a whole or for a frame."""
    path = bag(tmp_path, recorded(), storage, **options)
    file = path if path.is_file() else next(file for file in path.iterdir() if file.suffix in (".db3", ".mcap"))
    whole, random, refused = file.read_bytes(), np.random.default_rng(0), 0
    for place in random.integers(0, len(whole) - 8, 20):
        file.write_bytes(whole[:place] + random.bytes(8) + whole[place + 8 :])
        try:
            recording = open_recording(path)
            for i in range(len(recording)):
                recording[i]
        except (RecordingError, FrameError) as error:
            refused += 1
            assert "\n" not in str(error)
    assert refused > 0


def test_two_threads_share_a_bag(tmp_path: Path) -> None:
    recording, wrong = open_recording(bag(tmp_path, recorded(20), "sqlite3")), []

    def read(indices: range) -> None:
        wrong.extend(i for i in indices if abs(recording[i].depth[6, 8] - (1 + i / 1000)) > 1e-4)

    threads = [threading.Thread(target=read, args=(indices,)) for indices in (range(20), range(19, -1, -1))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong


def test_topics_are_for_recordings_that_have_some(tmp_path: Path, box_recording: Path) -> None:
    with pytest.raises(ConfigError, match=r"topics are named, but a recording of layout .* has none: leave --topics out"):
        open_recording(box_recording, topics={"colour": "/a"})
    with pytest.raises(ConfigError, match="topics: color unknown, expected colour, depth, camera_info, poses"):
        open_recording(box_recording, topics={"color": "/a"})


def test_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = bag(tmp_path, recorded())
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    with pytest.raises(ConfigError, match="-m pip install rosbags"):
        open_recording(path)


def test_a_database_that_is_none(tmp_path: Path) -> None:
    path = bag(tmp_path, recorded(), "sqlite3")
    file = next(path.glob("*.db3"))
    file.unlink()
    with sqlite3.connect(file) as database:
        database.execute("CREATE TABLE other (x INTEGER)")
    with pytest.raises(RecordingError, match="not a readable recording"):
        open_recording(path)


def test_a_stated_camera_is_taken_for_a_fisheye_s(tmp_path: Path) -> None:
    """Whoever states the camera of rectified images need not rename topics."""
    path = bag(tmp_path, [*leaving_out(INFO), (INFO, 99.9, camera_info(d=(0.1,) * 4, model="equidistant"))])
    (path.parent / "intrinsics.txt").write_text("20 21 7 5")
    assert open_recording(path).camera == Camera(WIDTH, HEIGHT, 20.0, 21.0, 7.0, 5.0)
