"""Images of ROS messages (sensor_msgs Image and CompressedImage) as arrays. Whatever is wrong with one image is a FrameError."""

import struct
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from idfslam.datasets.images.decoding import Depth, decode_colour, decode_depth
from idfslam.datasets.ros.rvl import decode_rvl
from idfslam.errors import FrameError

IMAGE, COMPRESSED = "sensor_msgs/Image", "sensor_msgs/CompressedImage"

_COLOUR: dict[str, tuple[int, int | None]] = {  # encoding -> channels of 8 bits, OpenCV's conversion to BGR
    "bgr8": (3, None),
    "8UC3": (3, None),
    "rgb8": (3, cv2.COLOR_RGB2BGR),
    "bgra8": (4, cv2.COLOR_BGRA2BGR),
    "8UC4": (4, cv2.COLOR_BGRA2BGR),
    "rgba8": (4, cv2.COLOR_RGBA2BGR),
    "yuv422": (2, cv2.COLOR_YUV2BGR_UYVY),
    "uyvy": (2, cv2.COLOR_YUV2BGR_UYVY),
    "yuv422_yuy2": (2, cv2.COLOR_YUV2BGR_YUY2),
    "yuyv": (2, cv2.COLOR_YUV2BGR_YUY2),
    "bayer_rggb8": (1, cv2.COLOR_BayerBG2BGR),  # OpenCV names a pattern by its second row
    "bayer_bggr8": (1, cv2.COLOR_BayerRG2BGR),
    "bayer_gbrg8": (1, cv2.COLOR_BayerGR2BGR),
    "bayer_grbg8": (1, cv2.COLOR_BayerGB2BGR),
}
_GREY: dict[str, tuple[int, int | None]] = {"mono8": (1, cv2.COLOR_GRAY2BGR), "8UC1": (1, cv2.COLOR_GRAY2BGR)}
_DEPTH: dict[str, np.dtype[Any]] = {  # millimetres, millimetres, metres
    "16UC1": np.dtype(np.uint16),
    "mono16": np.dtype(np.uint16),
    "32FC1": np.dtype(np.float32),
}
_CONFIG = struct.Struct("<iff")  # before a compressedDepth image: format, quantisation a, b


def kind(message: Any) -> str | None:
    """The kind of an image: "colour", "grey" or "depth"; None: none of these."""
    encoding = _encoding(message)
    if not hasattr(message, "encoding") and "compressedDepth" not in message.format:
        return "depth" if encoding in _DEPTH else "grey" if encoding in _GREY else "colour"
    return "colour" if encoding in _COLOUR else "grey" if encoding in _GREY else "depth" if encoding in _DEPTH else None


def units_per_metre(message: Any) -> float:
    """Units per metre of a depth image."""
    return 1.0 if _encoding(message) == "32FC1" else 1000.0


def _encoding(message: Any) -> str:
    """The encoding of an image; for a compressed one, the part of its format before the semicolon: "rgb8; jpeg compressed bgr8"."""
    return str(message.encoding if hasattr(message, "encoding") else message.format.split(";")[0]).strip()


def colour_of(message: Any, source: str) -> NDArray[np.uint8]:
    """(H, W, 3) BGR; `source` names the image in messages."""
    if not hasattr(message, "encoding"):
        return decode_colour(message.data.tobytes(), source)
    encodings = _COLOUR | _GREY
    if message.encoding not in encodings:
        raise FrameError(f"{source}: encoding {message.encoding}, expected one of {', '.join(encodings)}")
    channels, conversion = encodings[message.encoding]
    image = _pixels(message, np.dtype(np.uint8), channels, source)
    return np.ascontiguousarray(image) if conversion is None else np.asarray(cv2.cvtColor(image, conversion), np.uint8)


def depth_of(message: Any, source: str) -> Depth:
    """(H, W) uint16 or float32, as stored; `source` names the image in messages."""
    if not hasattr(message, "encoding"):
        return _unpacked(message, source)
    if message.encoding not in _DEPTH:
        raise FrameError(f"{source}: encoding {message.encoding}, expected depth as 16UC1 (millimetres) or 32FC1 (metres)")
    image = _pixels(message, _DEPTH[message.encoding], 1, source)
    return image.astype(_DEPTH[message.encoding])  # in this machine's byte order


def _pixels(message: Any, dtype: np.dtype[Any], channels: int, source: str) -> NDArray[Any]:
    """(H, W) or (H, W, channels); rows in the message may have padding."""
    length = message.width * channels * dtype.itemsize
    if message.step < length or len(message.data) < message.step * message.height or not message.height * length:
        found = f"{len(message.data)} bytes, {message.step} a row"
        raise FrameError(f"{source}: {found}, expected {message.width}x{message.height} {message.encoding}: copy the recording again")
    rows = np.asarray(message.data)[: message.step * message.height].reshape(message.height, message.step)
    image = np.ascontiguousarray(rows[:, :length]).view(dtype.newbyteorder(">" if message.is_bigendian else "<"))
    return image.reshape(message.height, message.width, channels) if channels > 1 else image


def _unpacked(message: Any, source: str) -> Depth:
    """Decodes depth stored as PNG or by RVL, after the header of `compressedDepth` if there is one; 32FC1 is stored as a / z + b."""
    data, packed = message.data.tobytes(), "compressedDepth" in message.format
    if len(data) < _CONFIG.size:
        raise FrameError(f"{source}: {len(data)} bytes, expected a depth image: copy the recording again")
    decode = decode_rvl if packed and "rvl" in message.format.lower() else decode_depth
    raw = decode(data[_CONFIG.size :] if packed else data, source)
    if _encoding(message) != "32FC1":
        return raw
    _, a, b = _CONFIG.unpack_from(data)
    return np.divide(a, raw - np.float32(b), out=np.zeros(raw.shape, np.float32), where=raw > 0, dtype=np.float32)
