"""A ROS 2 node. It reads RGB-D topics, publishes the camera's pose (also with covariance, and TF), path and status, and writes results.

    python -m idfslam.ros2.node --ros-args -p colour_topic:=/camera/color/image_raw -p preset:=fast -p out:=results/robot

Run it in a sourced ROS 2 environment: rclpy, message_filters, tf2_ros and the messages come with ROS and are not on PyPI. The node is
tested against stand-ins with the same interface, not against a running ROS 2.

Colour and depth are paired by their time stamps. The node always takes the newest pair; pairs that arrive while a frame is processed are
dropped and counted. ROS maps have z up: the map's x axis points where the first camera looked, y to its left, z up. The depth images must
be registered to the colour images.
"""

import logging
import math
import sys
import threading
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field, fields
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from idfslam.errors import ConfigError, FrameError, IdfSlamError
from idfslam.ros2.messages import covariance_in_map, fill, frame_of, pose_in_map

log = logging.getLogger(__name__)

_MODULES = ("rclpy", "message_filters", "tf2_ros", "sensor_msgs.msg", "geometry_msgs.msg", "nav_msgs.msg", "std_msgs.msg")
_QUEUE = 10  # messages of each topic that are kept for pairing; more tolerate larger delays between the topics


@dataclass(frozen=True)
class Parameters:
    """The node's ROS parameters."""

    colour_topic: str = "/camera/color/image_raw"
    depth_topic: str = "/camera/aligned_depth_to_color/image_raw"
    info_topic: str = "/camera/color/camera_info"
    slop: float = 0.02  # [s] the largest difference between the time stamps of a pair
    depth_scale: float = 1000.0  # units per metre of 16-bit depth; 32FC1 is in metres
    readout: float = math.nan  # [s] read-out time of colour, 0: global shutter; NaN: unknown
    depth_readout: float = math.nan  # [s] the same of depth
    depth_delay: float = math.nan  # [s] by which depth is taken later than its stamps say; NaN: unknown
    preset: str = "fast"
    config: str = ""  # a YAML file whose values override the preset's
    out: str = ""  # the result folder; empty: results/ros2, with a number if that is taken
    overwrite: bool = False  # replace the results in `out`
    map_frame: str = "map"
    camera_frame: str = ""  # empty: the frame in the colour image's header
    publish_tf: bool = True


@dataclass
class ReceivedFrames:
    """The frames received so far, as a source of frames without ground truth."""

    camera: Any = None  # of the newest frame
    stamps: list[float] = field(default_factory=list)  # [s]
    name: str = "ros2"
    ground_truth: NDArray[np.float64] | None = None

    @property
    def timestamps(self) -> NDArray[np.float64]:
        """(N,) [s]."""
        return np.array(self.stamps, np.float64)

    def add(self, frame: Any) -> None:
        """Counts a frame that has been processed."""
        self.camera = frame.camera
        self.stamps.append(frame.timestamp)


class SlamNode:
    """Subscribes to the topics, runs Slam on the newest frame in a thread of its own, and publishes. `close` writes the results."""

    def __init__(self, ros: SimpleNamespace) -> None:
        from idfslam.compute.torch_threads import limit_torch_threads
        from idfslam.config import load, preset
        from idfslam.runs.run_folder import claimed, folder_for
        from idfslam.runs.run_state import RunState
        from idfslam.slam import Slam

        self._ros, self.node = ros, ros.rclpy.create_node("idf_slam")
        given = {f.name: self.node.declare_parameter(f.name, f.default).value for f in fields(Parameters)}
        self.parameters = Parameters(**given)
        p = self.parameters
        config = load(Path(p.config), base=p.preset) if p.config else preset(p.preset)
        self._claim = ExitStack()
        out = folder_for("ros2", Path(p.out) if p.out else None, overwrite=p.overwrite)
        self._folder = self._claim.enter_context(claimed(out, overwrite=p.overwrite))
        limit_torch_threads(config.field.encoding)
        self._state = RunState(Slam(config))
        self._state.slam.swap_to(self._folder.partial)
        self._timing = timing_of(p)
        self._received, self.dropped = ReceivedFrames(), 0
        self._newest: tuple[Any, Any, Any] | None = None
        self._arrived, self._closing = threading.Condition(), False
        self._advertise()
        self._subscribe()
        self._worker = threading.Thread(target=self._work, name="slam")
        self._worker.start()

    def _advertise(self) -> None:
        ros, publisher = self._ros, self.node.create_publisher
        self._pose = publisher(ros.geometry_msgs.PoseStamped, "~/pose", _QUEUE)
        self._uncertain = publisher(ros.geometry_msgs.PoseWithCovarianceStamped, "~/pose_with_covariance", _QUEUE)
        self._path = publisher(ros.nav_msgs.Path, "~/path", 1)
        self._status = publisher(ros.std_msgs.String, "~/status", _QUEUE)
        self._tf = ros.tf2_ros.TransformBroadcaster(self.node)

    def _subscribe(self) -> None:
        ros, p = self._ros, self.parameters
        topics = (
            (ros.sensor_msgs.Image, p.colour_topic),
            (ros.sensor_msgs.Image, p.depth_topic),
            (ros.sensor_msgs.CameraInfo, p.info_topic),
        )
        subscribers = [ros.message_filters.Subscriber(self.node, kind, topic) for kind, topic in topics]
        self._pairs = ros.message_filters.ApproximateTimeSynchronizer(subscribers, _QUEUE, p.slop)
        self._pairs.registerCallback(self.receive)

    def receive(self, colour: Any, depth: Any, info: Any) -> None:
        """Takes a pair with its camera. The pair before is dropped if it is still waiting."""
        with self._arrived:
            self.dropped += self._newest is not None
            self._newest = (colour, depth, info)
            self._arrived.notify()

    def _work(self) -> None:
        while True:
            with self._arrived:
                self._arrived.wait_for(lambda: self._newest is not None or self._closing)
                if self._newest is None:
                    return
                messages, self._newest = self._newest, None
            try:
                self._process(*messages)
            except FrameError as error:
                log.warning("%s; the frame is left out", error)
            except IdfSlamError as error:
                log.error("%s; no further frame is taken", error)
                return

    def _process(self, colour: Any, depth: Any, info: Any) -> None:
        frame = frame_of(len(self._received.stamps), colour, depth, info, self.parameters.depth_scale, self._timing)
        result = self._state.process(frame)
        self._received.add(frame)
        self._publish(colour.header, result)

    def _publish(self, header: Any, result: Any) -> None:
        ros, p = self._ros, self.parameters
        position, quaternion = pose_in_map(result.T_wc)
        pose = self._pose_message(header, result.T_wc)
        self._pose.publish(pose)
        if result.status.measured and result.covariance is not None:
            uncertain = ros.geometry_msgs.PoseWithCovarianceStamped(header=pose.header)
            uncertain.pose.pose, uncertain.pose.covariance = pose.pose, covariance_in_map(result.covariance)
            self._uncertain.publish(uncertain)
        if p.publish_tf:
            transform = ros.geometry_msgs.TransformStamped()
            transform.header, transform.child_frame_id = pose.header, p.camera_frame or header.frame_id
            fill(transform.transform.translation, "xyz", position)
            fill(transform.transform.rotation, "xyzw", quaternion)
            self._tf.sendTransform(transform)
        if result.keyframe:  # the whole path is published again: a new keyframe may have moved the others
            path = ros.nav_msgs.Path(header=pose.header)
            path.poses = [self._pose_message(header, k.T_wk) for k in self._state.slam.stored_keyframes() if k.submap == 0]
            self._path.publish(path)
        self._status.publish(
            ros.std_msgs.String(data=f"{result.status.value}, frame {result.index}, dropped {self.dropped}{possible_error(result)}")
        )

    def _pose_message(self, header: Any, T_wc: NDArray[np.float64]) -> Any:
        message = self._ros.geometry_msgs.PoseStamped()
        message.header.stamp, message.header.frame_id = header.stamp, self.parameters.map_frame
        position, quaternion = pose_in_map(T_wc)
        fill(message.pose.position, "xyz", position)
        fill(message.pose.orientation, "xyzw", quaternion)
        return message

    def close(self) -> None:
        """Waits for the current frame, refines the map, and writes the results, if any frame had depth."""
        with self._arrived:
            self._closing, self._newest = True, None
            self._arrived.notify()
        self._worker.join()
        with self._claim:
            self._end()

    def _end(self) -> None:
        if self._state.slam.stored_keyframes():
            self._state.slam.finish()
            self._write()
            log.warning("%d frames, %d dropped: results in %s", len(self._received.stamps), self.dropped, self._folder.path)
        else:
            log.warning("no frame with depth came on %s and %s: no results", self.parameters.colour_topic, self.parameters.depth_topic)

    def _write(self) -> None:
        from idfslam.runs.metrics import run_metrics
        from idfslam.runs.result_writer import ResultWriter

        slam, received, meter, frame_log = self._state.slam, self._received, self._state.meter, self._state.frame_log
        metrics = run_metrics(slam, received, meter, frame_log, interrupted=False) | {"dropped_frames": self.dropped}
        writer = ResultWriter(self._folder.partial, slam, received, slam.config)
        writer.write_all(slam.mesh(), frame_log, metrics)
        self._folder.swap()


def timing_of(parameters: Parameters) -> Any:
    """The SensorTiming that the parameters state. Raises ConfigError for values that are no sensor's."""
    from idfslam.geometry.sensor_timing import SensorTiming

    stated = (parameters.readout, parameters.depth_readout, parameters.depth_delay)
    return SensorTiming(*(None if math.isnan(value) else value for value in stated))


def possible_error(result: Any) -> str:
    """How far the pose of a doubtful frame may be off, in words; empty for other frames, and where it is not known."""
    if result.status.value != "doubtful" or result.covariance is None:
        return ""
    return f", may be off by {result.sigma_position * 100:.1f} cm and {result.sigma_rotation:.1f} degrees"


def load_ros() -> SimpleNamespace:
    """The modules of ROS 2 by their names. Raises ConfigError if they cannot be imported."""
    try:
        return SimpleNamespace(**{name.removesuffix(".msg"): import_module(name) for name in _MODULES})
    except ImportError as error:
        raise ConfigError(
            f"no ROS 2 in this Python ({error}): source its setup file (source /opt/ros/.../setup.bash) and try again"
        ) from error


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs the node until Ctrl-C or the end of ROS and writes the results. A user's mistake ends it with one line and exit status 1."""
    from idfslam.compute.process import prepare_process

    prepare_process()
    logging.basicConfig(level=logging.WARNING, format="%(message)s")
    try:
        ros = load_ros()
        ros.rclpy.init(args=arguments)
        node = SlamNode(ros)
    except IdfSlamError as error:
        print(f"error: {error}", file=sys.stderr)
        raise SystemExit(1) from None
    log.warning("listening: %s", asdict(node.parameters))
    try:
        ros.rclpy.spin(node.node)
    except (KeyboardInterrupt, ros.rclpy.executors.ExternalShutdownException):
        pass
    finally:
        node.close()
        node.node.destroy_node()
        ros.rclpy.try_shutdown()


if __name__ == "__main__":
    main()
