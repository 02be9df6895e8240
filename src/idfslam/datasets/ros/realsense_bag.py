"""Peculiarities of .bag files of the RealSense Viewer and SDK: ROS 1 bags with topics such as /device_0/sensor_0/Depth_0.

Camera and extrinsics of a stream are in topics next to its images. The extrinsics lead from the device's reference stream to the stream
(librealsense, ros_file_format.h).
"""

import re

import numpy as np
from numpy.typing import NDArray

from idfslam.datasets.ros.bag import Bag
from idfslam.datasets.ros.transforms import matrix
from idfslam.errors import RecordingError

_STREAM = re.compile(r"(?P<prefix>/device_\d+/sensor_\d+)/(?P<stream>[A-Za-z]+)_\d+(?=/image/data$)")


def is_stream(topic: str) -> bool:
    return _STREAM.match(topic) is not None


def kind(topic: str) -> str | None:
    """The kind of a stream: "colour" or "depth"; None: infrared or fisheye."""
    stream = _STREAM.match(topic)
    return {"Depth": "depth", "Color": "colour"}.get(stream["stream"]) if stream else None


def camera_info(topic: str) -> str | None:
    """The topic with the stream's camera."""
    stream = _STREAM.match(topic)
    return f"{stream[0]}/info/camera_info" if stream else None


def units_per_metre(bag: Bag, topic: str) -> float:
    """Units per metre of a stream's depth images, from its sensor's option; millimetres if it has none."""
    stream = _STREAM.match(topic)
    for option in bag.types:
        if stream and re.fullmatch(re.escape(stream["prefix"]) + r"/option/Depth.Units/value", option):
            return round(1 / float(bag.first(option).data), 3)
    return 1000.0


def T_colour_depth(bag: Bag, colour: str, depth: str) -> NDArray[np.float64]:
    """(4, 4) [m] depth stream to colour stream; raises RecordingError if the recording has no extrinsics."""
    return _from_reference(bag, colour) @ np.linalg.inv(_from_reference(bag, depth))


def _from_reference(bag: Bag, topic: str) -> NDArray[np.float64]:
    """T_stream_reference (4, 4)."""
    stream = _STREAM.match(topic)
    topics = [name for name in bag.topics("geometry_msgs/Transform") if stream and name.startswith(f"{stream[0]}/tf/")]
    if not topics:
        raise RecordingError(f"{bag.path}: {topic} has no extrinsics (its tf topic), expected a bag of the RealSense SDK: record again")
    transform = bag.first(topics[0])
    return matrix(transform.translation, transform.rotation, f"{bag.path}: {topics[0]}")
