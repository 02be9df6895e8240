"""What is peculiar to .bag files of the RealSense Viewer and SDK: ROS 1 bags whose topics begin with /device_0/sensor_0/Depth_0.

Camera and extrinsics of a stream lie in topics beside its images; the latter lead from the device's reference stream to the stream itself
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
    """ "colour" or "depth"; None: an infrared or fisheye stream."""
    found = _STREAM.match(topic)
    return {"Depth": "depth", "Color": "colour"}.get(found["stream"]) if found else None


def camera_info(topic: str) -> str | None:
    """The topic of the stream's camera."""
    found = _STREAM.match(topic)
    return f"{found[0]}/info/camera_info" if found else None


def units_per_metre(bag: Bag, topic: str) -> float:
    """Of the depth images of a stream: its sensor's option, else millimetres."""
    found = _STREAM.match(topic)
    for option in bag.types:
        if found and re.fullmatch(re.escape(found["prefix"]) + r"/option/Depth.Units/value", option):
            return round(1 / float(bag.first(option).data), 3)
    return 1000.0


def T_colour_depth(bag: Bag, colour: str, depth: str) -> NDArray[np.float64]:
    """(4, 4); raises RecordingError where the recording does not say where the streams stand."""
    return _from_reference(bag, colour) @ np.linalg.inv(_from_reference(bag, depth))


def _from_reference(bag: Bag, topic: str) -> NDArray[np.float64]:
    """T_stream_reference (4, 4)."""
    found = _STREAM.match(topic)
    topics = [name for name in bag.topics("geometry_msgs/Transform") if found and name.startswith(f"{found[0]}/tf/")]
    if not topics:
        raise RecordingError(f"{bag.path}: {topic} has no extrinsics (its tf topic), expected a bag of the RealSense SDK: record again")
    transform = bag.first(topics[0])
    return matrix(transform.translation, transform.rotation, f"{bag.path}: {topics[0]}")
