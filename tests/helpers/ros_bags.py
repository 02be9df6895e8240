"""ROS bags for the tests, written by rosbags: a list of (topic, seconds, message), as ROS 1, ROS 2 in sqlite3 or in MCAP."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

from helpers.recordings import HEIGHT, WIDTH, colour_image, depth_image

ROS1, ROS2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_HUMBLE)
ROS1.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
COLOUR, DEPTH = "/camera/color/image_raw", "/camera/aligned_depth_to_color/image_raw"
INFO = "/camera/color/camera_info"

Message = Callable[[Any], Any]  # by the typestore, since the two versions differ
Recorded = list[tuple[str, float, Message]]


def header(store: Any, stamp: float, frame: str) -> Any:
    types = store.types
    seconds = int(stamp)
    time = types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=round((stamp - seconds) * 1e9))
    return types["std_msgs/msg/Header"](**({"seq": 0} if store is ROS1 else {}), stamp=time, frame_id=frame)


def image(array: np.ndarray, encoding: str, stamp: float, frame: str = "camera_color_optical_frame", pad: int = 0) -> Message:
    """pad: bytes behind each row."""
    rows = np.ascontiguousarray(array).view(np.uint8).reshape(array.shape[0], -1)
    data = np.pad(rows, ((0, 0), (0, pad))).ravel()
    fields = {"height": array.shape[0], "width": array.shape[1], "encoding": encoding, "is_bigendian": 0, "step": rows.shape[1] + pad}
    return lambda store: store.types["sensor_msgs/msg/Image"](header=header(store, stamp, frame), data=data, **fields)


def compressed(data: bytes, form: str, stamp: float, frame: str = "camera_color_optical_frame") -> Message:
    array = np.frombuffer(data, np.uint8)
    return lambda store: store.types["sensor_msgs/msg/CompressedImage"](header=header(store, stamp, frame), format=form, data=array)


def camera_info(
    *, K: tuple[float, ...] = (15, 15, 7.5, 5.5), d: tuple[float, ...] = (0.0,) * 5, model: str = "plumb_bob",
    size: tuple[int, int] = (WIDTH, HEIGHT), frame: str = "camera_color_optical_frame", P: tuple[float, ...] | None = None,
) -> Message:  # fmt: skip
    def matrix(values: tuple[float, ...], columns: int) -> np.ndarray:
        out = np.zeros((3, columns))
        out[[0, 1, 0, 1], [0, 1, 2, 2]], out[2, 2] = values, 1 if any(values) else 0
        return out.ravel()

    def make(store: Any) -> Any:
        values = {"d": np.array(d), "k": matrix(K, 3), "r": np.eye(3).ravel(), "p": matrix(P or K, 4)}
        types = store.types
        roi = types["sensor_msgs/msg/RegionOfInterest"](x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
        return types["sensor_msgs/msg/CameraInfo"](
            header=header(store, 1.0, frame), height=size[1], width=size[0], distortion_model=model,
            **({key.upper(): value for key, value in values.items()} if store is ROS1 else values), binning_x=0, binning_y=0, roi=roi,
        )  # fmt: skip

    return make


def _quaternion(store: Any, T: np.ndarray) -> Any:
    return store.types["geometry_msgs/msg/Quaternion"](**dict(zip("xyzw", Rotation.from_matrix(T[:3, :3]).as_quat(), strict=True)))


def transform(T: np.ndarray) -> Message:
    def make(store: Any) -> Any:
        t = store.types["geometry_msgs/msg/Vector3"](**dict(zip("xyz", T[:3, 3], strict=True)))
        return store.types["geometry_msgs/msg/Transform"](translation=t, rotation=_quaternion(store, T))

    return make


def tf(parent: str, child: str, T_parent_child: np.ndarray) -> Message:
    def make(store: Any) -> Any:
        stamped = store.types["geometry_msgs/msg/TransformStamped"](header(store, 1.0, parent), child, transform(T_parent_child)(store))
        return store.types["tf2_msgs/msg/TFMessage"](transforms=[stamped])

    return make


def pose_message(stamp: float, T: np.ndarray, *, child: str | None = None) -> Message:
    """PoseStamped, or Odometry where a child frame is named."""

    def make(store: Any) -> Any:
        types = store.types
        point = types["geometry_msgs/msg/Point"](**dict(zip("xyz", T[:3, 3], strict=True)))
        at = types["geometry_msgs/msg/Pose"](position=point, orientation=_quaternion(store, T))
        if child is None:
            return types["geometry_msgs/msg/PoseStamped"](header=header(store, stamp, "map"), pose=at)
        zero = types["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0)
        twist = types["geometry_msgs/msg/TwistWithCovariance"](types["geometry_msgs/msg/Twist"](zero, zero), np.zeros(36))
        uncertain = types["geometry_msgs/msg/PoseWithCovariance"](at, np.zeros(36))
        return types["nav_msgs/msg/Odometry"](header(store, stamp, "odom"), child, uncertain, twist)

    return make


def float32(value: float) -> Message:
    return lambda store: store.types["std_msgs/msg/Float32"](data=value)


def text(value: str) -> Message:
    return lambda store: store.types["std_msgs/msg/String"](data=value)


def recorded(frames: int = 3, *, late: float = 0.0) -> Recorded:
    """Colour rgb8 and depth 16UC1 of `recordings` at 100 + i / 30 s, depth stamped `late` and arriving half a frame later."""
    out: Recorded = [(INFO, 99.9, camera_info())]
    for i in range(frames):
        stamp = 100 + i / 30
        out.append((COLOUR, stamp + 0.001, image(colour_image(i)[..., ::-1], "rgb8", stamp)))
        out.append((DEPTH, stamp + 0.025, image(depth_image(1000 + i), "16UC1", stamp + late)))
        out.append(("/chatter", stamp, text("hello")))
    return out


def write_bag(path: Path, messages: Recorded, storage: str = "ros1", **options: Any) -> Path:
    """storage: ros1 (path is a .bag file), sqlite3 or mcap (a folder). Messages are written in the order of their arrival."""
    path.parent.mkdir(parents=True, exist_ok=True)
    store = ROS1 if storage == "ros1" else ROS2
    writer: Any = Writer1(path) if storage == "ros1" else Writer2(path, version=9, storage_plugin=StoragePlugin[storage.upper()])
    for name, value in options.items():
        getattr(writer, name)(*value)
    with writer:
        connections: dict[str, Any] = {}
        for topic, time, make in sorted(messages, key=lambda entry: entry[1]):
            message = make(store)
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, message.__msgtype__, typestore=store)
            serialise = store.serialize_ros1 if storage == "ros1" else store.serialize_cdr
            writer.write(connections[topic], round(time * 1e9), serialise(message, message.__msgtype__))
    return path


def compressed_depth(metres: np.ndarray, stamp: float, *, encoding: str) -> Message:
    """As image_transport's compressedDepth: 12 bytes of quantisation, then PNG; 32FC1 as a / z + b."""
    if encoding == "16UC1":
        a, b, raw = 0.0, 0.0, np.round(metres * 1000).astype(np.uint16)
    else:
        a = 100 * 101.0
        b = 1 - a / 10
        raw = np.where(metres > 0, np.round(a / np.where(metres > 0, metres, 1) + b), 0).astype(np.uint16)
    data = np.array([0], "<i4").tobytes() + np.array([a, b], "<f4").tobytes() + cv2.imencode(".png", raw)[1].tobytes()
    return compressed(data, f"{encoding}; compressedDepth png", stamp)
