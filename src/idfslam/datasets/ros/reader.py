"""ROS 1 bags (also RealSense's), ROS 2 bags and MCAP files. The topics of colour and depth are detected, or named by the user."""

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from idfslam.datasets.cameras.calibration import Calibration, DepthCameraCalibration
from idfslam.datasets.images.decoding import Depth
from idfslam.datasets.images.partners import stamps_of, warn_without_own, with_nearest
from idfslam.datasets.poses.truth import Truth, at_stamps
from idfslam.datasets.recording import Reader, Recording
from idfslam.datasets.ros import realsense_bag
from idfslam.datasets.ros.bag import SUFFIXES, Bag, IndexedMessage
from idfslam.datasets.ros.images import colour_of, depth_of, units_per_metre
from idfslam.datasets.ros.topic_search import CAMERA_INFO, ImageTopic, find_camera, find_images
from idfslam.datasets.ros.transforms import StaticFrames, matrix
from idfslam.datasets.topics import Topics
from idfslam.errors import RecordingError
from idfslam.geometry.association import TOLERANCE, associate

log = logging.getLogger(__name__)

_POSES = (  # types of messages that hold one pose
    "geometry_msgs/PoseStamped",
    "geometry_msgs/PoseWithCovarianceStamped",
    "geometry_msgs/TransformStamped",
    "nav_msgs/Odometry",
)


def recognises(path: Path) -> bool:
    return _is_bag(path) if path.is_file() else (path / "metadata.yaml").is_file() or bool(_files(path))


def _is_bag(path: Path) -> bool:
    return path.suffix.lower() in SUFFIXES or _is_unfinished(path)


def _is_unfinished(path: Path) -> bool:
    """Whether rosbag gave a bag this name while it recorded it."""
    return path.name.lower().endswith(".bag.active")


def _files(path: Path) -> list[Path]:
    return sorted(file for file in path.glob("*") if _is_bag(file) and not file.name.startswith("."))


def _bag(path: Path) -> Path:
    """The bag at a path: a file, or the folder of a ROS 2 bag."""
    if path.is_file() and _is_unfinished(path):
        raise RecordingError(f"{path}: rosbag did not finish this bag: run `rosbag reindex` on it, then rename it to end in .bag")
    if path.is_file() or (path / "metadata.yaml").is_file():
        return path
    files = _files(path)
    if len(files) != 1:
        raise RecordingError(
            f"{path}: {len(files)} bags and no metadata.yaml, expected a ROS 2 bag's folder or one .bag or .mcap: name one"
        )
    return _bag(files[0])


def open_ros(path: Path, stated: Calibration, topics: Topics | None = None) -> Recording:
    """Pairs images whose header stamps differ by at most 20 ms. Every colour image is a frame, also one without a depth image."""
    topics, path = topics or Topics(), _bag(path)
    bag = Bag(path)
    colour, depth = find_images(bag, topics)
    camera = Calibration() if stated.complete else find_camera(bag, colour, topics.camera_info)
    if not stated.over(camera).complete:
        infos = ", ".join(bag.topics(CAMERA_INFO)) or "none at all"
        advice = "name it with --topics.camera-info, or give --camera.fx --camera.fy --camera.cx --camera.cy"
        raise RecordingError(f"{path}: no {CAMERA_INFO} for {colour.name} (found {infos}): {advice}")
    pose_topic = topics.poses
    if pose_topic is not None and bag.types.get(pose_topic) not in _POSES:
        found = ", ".join(bag.topics(*_POSES)) or "none"
        raise RecordingError(f"{path}: no poses in {pose_topic} (found {found}): name another with --topics.poses")
    static = [topic for topic in bag.topics("tf2_msgs/TFMessage") if "static" in topic]
    frames = StaticFrames((message for topic in static for message in bag.messages(topic)), f"{path}: /tf_static")
    index = bag.index(colour.name, depth.name)
    stamps = {name: np.array([entry.stamp for entry in index[name]]) for name in index}
    pairs = associate(stamps[colour.name], stamps[depth.name])
    if not len(pairs):
        found = f"{len(stamps[colour.name])} images in {colour.name} and {len(stamps[depth.name])} in {depth.name}"
        raise RecordingError(f"{path}: {found}, none within {1000 * TOLERANCE:.0f} ms of another, expected stamps of one clock")
    log.info("%s: colour from %s, depth from %s", path, colour.name, depth.name)
    timestamps, partner = stamps[colour.name], with_nearest(pairs, stamps[colour.name], stamps[depth.name])
    warn_without_own(str(path), len(pairs), len(partner))
    depths: list[IndexedMessage | None] = [*index[depth.name], None]  # the last one is number -1
    scale = realsense_bag.units_per_metre(bag, depth.name) if realsense_bag.is_stream(depth.name) else units_per_metre(depth.message)
    return Recording(
        path.stem,
        RosImages(bag, colour.name, depth.name, [(entry, depths[k]) for entry, k in zip(index[colour.name], partner.tolist())]),
        timestamps=timestamps,
        depth_timestamps=stamps_of(stamps[depth.name], partner),
        ground_truth=None if pose_topic is None else lambda: read_truth(bag, pose_topic, colour.frame, frames, timestamps),
        calibration=stated.over(camera).over(Calibration(depth_scale=scale)),
        depth_camera=_depth_camera(bag, colour, depth, frames, named=topics.depth is not None),
    )


@dataclass(frozen=True)
class RosImages:
    """Called with i, returns colour and depth of pair i; None where it has no depth."""

    bag: Bag
    colour: str
    depth: str
    pairs: list[tuple[IndexedMessage, IndexedMessage | None]]

    def __call__(self, i: int) -> tuple[NDArray[np.uint8], Depth | None]:
        colour, depth = self.pairs[i]
        bgr = colour_of(self.bag.at(self.colour, colour), f"{self.bag.path}: {self.colour} at {colour.stamp:.3f} s")
        if depth is None:
            return bgr, None
        return bgr, depth_of(self.bag.at(self.depth, depth), f"{self.bag.path}: {self.depth} at {depth.stamp:.3f} s")


def _depth_camera(bag: Bag, colour: ImageTopic, depth: ImageTopic, frames: StaticFrames, *, named: bool) -> DepthCameraCalibration | None:
    """The depth camera if depth is not registered to colour, else None; raises RecordingError if its pose is unknown."""
    if realsense_bag.is_stream(depth.name) and realsense_bag.is_stream(colour.name):
        T = realsense_bag.T_colour_depth(bag, colour.name, depth.name)
    elif depth.registered or depth.frame == colour.frame:
        return None
    elif (T_static := frames.T(colour.frame, depth.frame)) is not None:
        T = T_static
    elif named:
        log.warning("%s: the pose of %s is unknown; it is assumed to be registered to %s", bag.path, depth.name, colour.name)
        return None
    else:
        found = f"{depth.name} in frame {depth.frame}, {colour.name} in {colour.frame}, and no /tf_static between"
        raise RecordingError(f"{bag.path}: {found}: record depth registered to colour, or name it with --topics.depth if it is")
    camera = find_camera(bag, depth)
    if not camera.complete:
        raise RecordingError(f"{bag.path}: no {CAMERA_INFO} for {depth.name}: record it, or depth registered to colour")
    return DepthCameraCalibration(camera, T)


def read_truth(bag: Bag, topic: str, camera: str, frames: StaticFrames, timestamps: NDArray[np.float64]) -> Truth:
    """The camera's poses (N, 4, 4) at stamps (N,) [s] from a topic, NaN where none is near in time.

    Poses of another frame are moved to the camera if /tf_static connects the two.
    """
    entries: list[tuple[float, NDArray[np.float64]]] = []
    for message in bag.messages(topic):
        T = frames.T(message.child_frame_id, camera) if hasattr(message, "child_frame_id") else None
        header = message.header.stamp
        entries.append((header.sec + header.nanosec / 1e9, _pose(message, f"{bag.path}: {topic}") @ (np.eye(4) if T is None else T)))
    if not entries:
        raise RecordingError(f"{bag.path}: no messages in {topic}")
    entries.sort(key=lambda entry: entry[0])
    stamps, reference = np.array([stamp for stamp, _ in entries]), np.stack([T for _, T in entries])
    return Truth(at_stamps(stamps, reference, timestamps, TOLERANCE), f"{bag.path}: {topic}")


def _pose(message: Any, source: str) -> NDArray[np.float64]:
    if hasattr(message, "transform"):
        return matrix(message.transform.translation, message.transform.rotation, source)
    pose = message.pose.pose if hasattr(message.pose, "pose") else message.pose
    return matrix(pose.position, pose.orientation, source)


READER = Reader("ros", "a .bag or .mcap file or a ROS 2 bag's folder", recognises, open_ros, open_ros)
