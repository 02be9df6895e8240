"""Messages of ROS 2 as frames, and poses as ROS has them: images become arrays, and the map has z up."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from idfslam.errors import FrameError

# The map's axes (x forward, y left, z up) in those of the first camera (x right, y down, z forward).
T_MAP_WORLD: NDArray[np.float64] = np.array([[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]], np.float64)
_CHANNELS = {"rgb8": (0, 1, 2), "bgr8": (2, 1, 0), "rgba8": (0, 1, 2), "bgra8": (2, 1, 0), "mono8": (0, 0, 0)}
_DEPTHS = {"16UC1": np.uint16, "mono16": np.uint16, "32FC1": np.float32}


def frame_of(index: int, colour: Any, depth: Any, info: Any, depth_scale: float, timing: Any = None) -> Any:
    """An undistorted Frame of sensor_msgs/Image (colour and depth, each with its stamp) and CameraInfo.

    timing: the sensor's SensorTiming; None: unknown. Raises FrameError if the messages do not fit together.
    """
    from idfslam.datasets.images.decoding import Undistortion, metres, rgb
    from idfslam.frame import Frame
    from idfslam.geometry.camera import Camera
    from idfslam.geometry.sensor_timing import UNKNOWN

    bgr, raw = colour_of(colour), depth_of(depth, depth_scale)
    camera = Camera(info.width, info.height, info.k[0], info.k[4], info.k[2], info.k[5])
    if not bgr.shape[:2] == raw.shape == (camera.height, camera.width):
        sizes = f"colour {bgr.shape[1]}x{bgr.shape[0]}, depth {raw.shape[1]}x{raw.shape[0]}, camera {camera.width}x{camera.height}"
        raise FrameError(f"frame {index}: {sizes}, expected one size: use the topic of the depth that is registered to colour")
    undistorted: Any = raw
    if any(info.d):
        undistort = Undistortion(camera, tuple(info.d))
        bgr, undistorted = undistort.colour(bgr), undistort.depth(raw)
    stamp, depth_stamp = (message.header.stamp.sec + message.header.stamp.nanosec * 1e-9 for message in (colour, depth))
    times = UNKNOWN if timing is None else timing
    return Frame(index, stamp, rgb(bgr), metres(undistorted, depth_scale), camera, depth_stamp, times)


def colour_of(message: Any) -> NDArray[np.uint8]:
    """sensor_msgs/Image -> (H, W, 3) BGR."""
    if message.encoding not in _CHANNELS:
        raise FrameError(f"colour of encoding '{message.encoding}', expected one of {', '.join(_CHANNELS)}")
    rows = np.frombuffer(bytes(message.data), np.uint8).reshape(message.height, message.step)
    r, g, b = _CHANNELS[message.encoding]
    channels = {"mono8": 1, "rgba8": 4, "bgra8": 4}.get(message.encoding, 3)
    pixels = rows[:, : message.width * channels].reshape(message.height, message.width, channels)
    return np.ascontiguousarray(pixels[..., [b, g, r]])


def depth_of(message: Any, scale: float) -> NDArray[np.uint16]:
    """sensor_msgs/Image of 16UC1, or of 32FC1 [m] -> (H, W) in units of 1/`scale` m, 0 where there is no reading."""
    if message.encoding not in _DEPTHS:
        raise FrameError(f"depth of encoding '{message.encoding}', expected one of {', '.join(_DEPTHS)}")
    kind = np.dtype(_DEPTHS[message.encoding]).newbyteorder(">" if message.is_bigendian else "<")
    rows = np.frombuffer(bytes(message.data), np.uint8).reshape(message.height, message.step)
    values = np.ascontiguousarray(rows[:, : message.width * kind.itemsize]).view(kind)
    if message.encoding == "32FC1":
        units = np.nan_to_num(values.astype(np.float64) * scale, nan=0.0, posinf=0.0, neginf=0.0)
        values = np.where((units > 0) & (units < np.iinfo(np.uint16).max), units.round(), 0)
    return values.astype(np.uint16)


def pose_in_map(T_wc: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Position (3,) [m] and quaternion (x, y, z, w) of the camera's optical frame in the map."""
    from scipy.spatial.transform import Rotation

    T = T_MAP_WORLD @ T_wc
    return T[:3, 3], Rotation.from_matrix(T[:3, :3]).as_quat(canonical=True)


def covariance_in_map(covariance: NDArray[np.float64]) -> list[float]:
    """The covariance (6, 6) of shift and turn along the world's axes along those of the map: 36 values by rows, as ROS has them."""
    turned = np.kron(np.eye(2), T_MAP_WORLD[:3, :3])
    return [float(value) for value in (turned @ covariance @ turned.T).ravel()]


def fill(message: Any, names: str, values: NDArray[np.float64]) -> None:
    """Sets the fields of a message: one letter of `names` for each value."""
    for name, value in zip(names, values):
        setattr(message, name, float(value))
