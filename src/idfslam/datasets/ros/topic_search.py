"""Detects the topics of the colour camera and its depth in a ROS recording, from their first messages and their names."""

from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Any

import numpy as np

from idfslam.datasets.cameras.calibration import Calibration
from idfslam.datasets.ros import realsense_bag
from idfslam.datasets.ros.bag import Bag
from idfslam.datasets.ros.images import COMPRESSED, IMAGE, kind
from idfslam.datasets.topics import Topics
from idfslam.errors import RecordingError

CAMERA_INFO = "sensor_msgs/CameraInfo"
_REGISTERED = ("aligned_depth_to_color", "depth_registered", "registered", "depth_to_rgb", "depth_to_color")  # in names of topics


@dataclass(frozen=True)
class ImageTopic:
    """A topic of images with its first message."""

    name: str
    kind: str | None  # "colour", "grey" or "depth"
    frame: str
    message: Any  # the first

    @property
    def base(self) -> str:
        """The name without the suffix of a compressed transport."""
        path = PurePosixPath(self.name)
        return str(path.parent) if path.name in ("compressed", "compressedDepth") else self.name

    @property
    def rectified(self) -> bool:
        return "rect" in PurePosixPath(self.base).name and "raw" not in PurePosixPath(self.base).name

    @property
    def registered(self) -> bool:
        """Whether the topic's name means depth registered to colour."""
        return any(word in self.name for word in _REGISTERED)


def find_images(bag: Bag, topics: Topics) -> tuple[ImageTopic, ImageTopic]:
    """The topics of colour and depth that fit together best, or the named ones; raises RecordingError if the choice is ambiguous."""
    images = [_image_topic(bag, name) for name in bag.topics(IMAGE, COMPRESSED)]
    depths = _named(bag, images, topics.depth, "depth", "16UC1 or 32FC1") or [topic for topic in images if topic.kind == "depth"]
    colours = _named(bag, images, topics.colour, "colour", "rgb8, bgr8, mono8, yuv422 ... or JPEG")
    colours = colours or [topic for topic in images if topic.kind == "colour"] or [topic for topic in images if topic.kind == "grey"]
    for candidates, what, flag in ((colours, "colour images", "colour"), (depths, "depth images (16UC1 or 32FC1)", "depth")):
        if not candidates:
            raise RecordingError(f"{bag.path}: no topic of {what} (found {_list(bag)}): name it with --topics.{flag}")
    ranked = sorted(((_fit(colour, depth), colour, depth) for colour in colours for depth in depths), key=lambda pair: pair[0])
    best = [(colour, depth) for fit, colour, depth in ranked if fit == ranked[-1][0]]
    if len(best) > 1:
        names = " or ".join(f"{colour.name} with {depth.name}" for colour, depth in best[:3])
        raise RecordingError(f"{bag.path}: {names} fit equally well: name them with --topics.colour and --topics.depth")
    return best[0]


def _image_topic(bag: Bag, name: str) -> ImageTopic:
    message = bag.first(name)
    image_kind = realsense_bag.kind(name) if realsense_bag.is_stream(name) else kind(message)
    return ImageTopic(name, image_kind, message.header.frame_id.strip("/"), message)


def _named(bag: Bag, images: list[ImageTopic], name: str | None, flag: str, expected: str) -> list[ImageTopic]:
    if name is None:
        return []
    named = [topic for topic in images if topic.name == name]
    if not named:
        raise RecordingError(f"{bag.path}: no images in {name} (found {_list(bag)}): name another with --topics.{flag}")
    if (named[0].kind == "depth") != (flag == "depth"):
        encoding = getattr(named[0].message, "encoding", None) or named[0].message.format
        raise RecordingError(f"{bag.path}: {name} holds {encoding}, expected {expected}: name another with --topics.{flag}")
    return named


def _list(bag: Bag) -> str:
    topics = bag.topics(IMAGE, COMPRESSED)
    return ", ".join(topics[:8]) + (" ..." if len(topics) > 8 else "") if topics else f"no images among {len(bag.types)} topics"


def _fit(colour: ImageTopic, depth: ImageTopic) -> tuple[bool, bool, int, bool, bool, bool]:
    """A sort key of how well two topics fit together; the most reliable criterion comes first."""
    parts = zip(PurePosixPath(colour.base).parts, PurePosixPath(depth.base).parts)
    common = int(np.cumprod([a == b for a, b in parts]).sum())
    same = bool(colour.frame) and colour.frame == depth.frame
    return (same, depth.registered, common, colour.rectified, colour.base == colour.name, depth.base == depth.name)


def find_camera(bag: Bag, image: ImageTopic, named: str | None = None) -> Calibration:
    """The camera of images: from the camera_info next to them, else from the only one of their frame; empty if there is none."""
    infos = bag.topics(CAMERA_INFO)
    if named is not None and named not in infos:
        found = f"found {', '.join(infos)}" if infos else "there is none"
        raise RecordingError(f"{bag.path}: no {CAMERA_INFO} in {named} ({found}): name another with --topics.camera-info")
    info_topic = named or realsense_bag.camera_info(image.name) or str(PurePosixPath(image.base).parent / "camera_info")
    if info_topic not in infos:
        of_frame = [topic for topic in infos if image.frame and bag.first(topic).header.frame_id.strip("/") == image.frame]
        if len(of_frame) != 1:
            return Calibration()
        info_topic = of_frame[0]
    return read_camera_info(bag.first(info_topic), rectified=image.rectified, source=f"{bag.path}: {info_topic}")


def read_camera_info(message: Any, *, rectified: bool, source: str) -> Calibration:
    """K and distortion, or P for rectified images; raises RecordingError if the distortion model is not supported."""
    K = np.asarray(message.p if hasattr(message, "p") else message.P, np.float64).reshape(3, 4)[:, :3]
    distortion: tuple[float, ...] = ()
    if not rectified or not K.any():
        K = np.asarray(message.k if hasattr(message, "k") else message.K, np.float64).reshape(3, 3)
        distortion = tuple(float(k) for k in (message.d if hasattr(message, "d") else message.D))
    if not K.any():
        return Calibration()  # the camera was never calibrated
    if any(distortion) and (message.distortion_model in ("equidistant", "fisheye") or len(distortion) not in (4, 5, 8)):
        found = f"distortion {message.distortion_model or 'without a name'} of {len(distortion)} values"
        raise RecordingError(f"{source}: {found}, expected plumb_bob or rational_polynomial: name rectified images with --topics.colour")
    fx, fy, cx, cy = (float(value) for value in K[[0, 1, 0, 1], [0, 1, 2, 2]])
    size = (message.width or None, message.height or None)
    return Calibration(fx, fy, cx, cy, *size, distortion if any(distortion) else None, source=source)
