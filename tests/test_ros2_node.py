"""The ROS 2 node against stand-ins of rclpy, message_filters, tf2_ros and the messages: the interface that the node uses, no more."""

import json
import sys
import time
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from helpers.box_room import BOX_FOCAL, BOX_HEIGHT, BOX_WIDTH, box_poses, box_view
from helpers.visible_files import visible_files
from idfslam.errors import ConfigError, FrameError
from idfslam.frame import FrameResult, Status
from idfslam.geometry.sensor_timing import SensorTiming
from idfslam.geometry.trajectory import load_tum
from idfslam.ros2.messages import colour_of, depth_of, frame_of, pose_in_map
from idfslam.ros2.node import Parameters, SlamNode, load_ros, main, timing_of
from idfslam.runs import result_folder
from idfslam.runs.frame_log import FrameLog


class Message(SimpleNamespace):
    """A message whose fields come to be when they are asked for, as the real ones have theirs from the start."""

    def __getattr__(self, name: str) -> "Message":
        if name.startswith("__"):
            raise AttributeError(name)
        value = Message()
        setattr(self, name, value)
        return value


class Node:
    def __init__(self, given: dict[str, Any]) -> None:
        self.given, self.declared, self.published = given, {}, {}  # type: dict[str, Any], dict[str, Any], dict[str, list[Any]]

    def declare_parameter(self, name: str, default: Any) -> SimpleNamespace:
        self.declared[name] = default
        return SimpleNamespace(value=self.given.get(name, default))

    def create_publisher(self, kind: type, topic: str, queue: int) -> SimpleNamespace:
        return SimpleNamespace(publish=self.published.setdefault(topic, []).append)

    def destroy_node(self) -> None:
        self.destroyed = True


def install(monkeypatch: pytest.MonkeyPatch, node: Node, spin: Any = None) -> dict[str, Any]:
    """Puts the stand-ins where the node finds them; returns what was subscribed and broadcast."""
    seen: dict[str, Any] = {"topics": [], "transforms": [], "callback": None, "ended": False}

    class Synchronizer:
        def __init__(self, subscribers: list[Any], queue: int, slop: float) -> None:
            seen["slop"] = slop

        def registerCallback(self, callback: Any) -> None:
            seen["callback"] = callback

    executors = SimpleNamespace(ExternalShutdownException=type("ExternalShutdownException", (Exception,), {}))
    end = {"try_shutdown": lambda: seen.update(ended=True), "executors": executors, "init": lambda args: None}
    contents: dict[str, dict[str, Any]] = {
        "rclpy": {"create_node": lambda name: node, "spin": spin, **end},
        "message_filters": {
            "Subscriber": lambda node, kind, topic: seen["topics"].append(topic),
            "ApproximateTimeSynchronizer": Synchronizer,
        },
        "tf2_ros": {"TransformBroadcaster": lambda node: SimpleNamespace(sendTransform=seen["transforms"].append)},
        "sensor_msgs.msg": {"Image": Message, "CameraInfo": Message},
        "geometry_msgs.msg": {"PoseStamped": Message, "PoseWithCovarianceStamped": Message, "TransformStamped": Message},
        "nav_msgs.msg": {"Path": Message},
        "std_msgs.msg": {"String": Message},
    }
    for name, content in contents.items():
        if "." in name:
            monkeypatch.setitem(sys.modules, name.split(".")[0], ModuleType(name.split(".")[0]))
        module = ModuleType(name)
        vars(module).update(content)
        monkeypatch.setitem(sys.modules, name, module)
    return seen


def test_covariance_and_doubt_are_told(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """World axes x right, y down, z forward are -y, -z and x of the map."""
    node = Node({"out": str(tmp_path / "out")})
    install(monkeypatch, node)
    slam_node = SlamNode(load_ros())
    header = SimpleNamespace(stamp=SimpleNamespace(sec=1, nanosec=0), frame_id="camera")
    P = np.diag([1e-4, 4e-4, 4e-4, 0.01, 0.02, 0.03])
    P[0, 2] = P[2, 0] = 1e-5
    for status in (Status.DOUBTFUL, Status.OK, Status.LOST):
        slam_node._publish(header, FrameResult(7, 1.0, np.eye(4), status, False, {}, P))
    slam_node._publish(header, FrameResult(8, 1.0, np.eye(4), Status.OK, False, {}))
    slam_node.close()
    published = node.published["~/pose_with_covariance"]
    assert len(published) == 2 and published[0].header.frame_id == "map"
    Q = np.array(published[0].pose.covariance).reshape(6, 6)
    np.testing.assert_allclose(np.diag(Q), [4e-4, 1e-4, 4e-4, 0.03, 0.01, 0.02])
    assert Q[0, 1] == pytest.approx(-1e-5) and published[0].pose.pose.position.x == 0.0
    told = [message.data for message in node.published["~/status"]]
    assert told[0] == "doubtful, frame 7, dropped 0, may be off by 3.0 cm and 14.0 degrees"
    assert told[1:] == ["ok, frame 7, dropped 0", "lost, frame 7, dropped 0", "ok, frame 8, dropped 0"]


def image(pixels: np.ndarray, encoding: str, i: int = 0, *, padding: int = 0, bigendian: bool = False) -> SimpleNamespace:
    rows = np.ascontiguousarray(pixels).view(np.uint8).reshape(len(pixels), -1)
    rows = np.pad(rows, ((0, 0), (0, padding)))
    header = SimpleNamespace(stamp=SimpleNamespace(sec=100, nanosec=i * 33_000_000), frame_id="camera_optical")
    size = {"height": pixels.shape[0], "width": pixels.shape[1], "step": rows.shape[1]}
    return SimpleNamespace(header=header, encoding=encoding, data=rows.tobytes(), is_bigendian=bigendian, **size)


def camera_info(d: tuple[float, ...] = ()) -> SimpleNamespace:
    k = [BOX_FOCAL, 0, (BOX_WIDTH - 1) / 2, 0, BOX_FOCAL, (BOX_HEIGHT - 1) / 2, 0, 0, 1]
    return SimpleNamespace(width=BOX_WIDTH, height=BOX_HEIGHT, k=k, d=d)


def box_messages(i: int) -> tuple[SimpleNamespace, SimpleNamespace, SimpleNamespace]:
    colour, depth = box_view(box_poses()[i])
    return image(colour, "bgr8", i), image(depth, "16UC1", i), camera_info()


def wait_for(condition: Any) -> None:
    end = time.monotonic() + 120
    while not condition():
        assert time.monotonic() < end, "nothing came"
        time.sleep(0.02)


def test_frames_come_out_as_poses_and_a_result_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "values.yaml").write_text(
        "{device: cpu, mapper: {first_iterations: 60}, refinement: {updates: 1}, mesh: {resolution: 0.1}}"
    )
    node = Node({"out": str(tmp_path / "out"), "config": str(tmp_path / "values.yaml"), "colour_topic": "/mine", "slop": 0.05})

    def spin(spun: Node) -> None:
        for i in range(4):
            seen["callback"](*box_messages(i))
            wait_for(lambda: len(node.published["~/status"]) == i + 1)  # noqa: B023
        raise KeyboardInterrupt

    seen = install(monkeypatch, node, spin)
    main([])
    assert seen["topics"] == ["/mine", "/camera/aligned_depth_to_color/image_raw", "/camera/color/camera_info"]
    assert seen["slop"] == 0.05
    poses = box_poses()[:4]
    T_wc = np.linalg.inv(poses[0]) @ poses
    for message, transform, T in zip(node.published["~/pose"], seen["transforms"], T_wc, strict=True):
        position = np.array([message.pose.position.x, message.pose.position.y, message.pose.position.z])
        assert np.allclose(position, [T[2, 3], -T[0, 3], -T[1, 3]], atol=0.01)  # forward, left, up
        assert message.header.frame_id == transform.header.frame_id == "map"
        assert transform.child_frame_id == "camera_optical"
        assert transform.transform.translation.x == message.pose.position.x
    assert node.published["~/status"][-1].data == "ok, frame 3, dropped 0"
    assert len(node.published["~/path"][0].poses) == 1
    written = load_tum(tmp_path / "out/trajectory.txt")
    assert np.allclose(written.timestamps, [100, 100.033, 100.066, 100.099])
    assert np.allclose(written.poses, T_wc, atol=0.01)
    assert visible_files(tmp_path / "out") == sorted(result_folder.FILES)
    metrics = json.loads((tmp_path / "out/metrics.json").read_text())
    expected = {"frames": 4, "dropped_frames": 0, "keyframes": 2, "lost_frames": 0}  # the first frame and, at the end, the last one
    assert {name: metrics[name] for name in expected} == expected
    log = FrameLog.load(tmp_path / "out/frames.csv")
    assert [(line.index, line.status.value) for line in log.lines] == [(i, "ok") for i in range(4)]
    assert node.destroyed
    assert seen["ended"]


def test_the_newest_frame_wins_and_a_bad_one_is_left_out(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    node = Node({"out": str(tmp_path)})
    install(monkeypatch, node)
    taken: list[Any] = []

    def slow(self: SlamNode, colour: Any, depth: Any, info: Any) -> None:
        time.sleep(0.2)
        if colour == 4:
            raise FrameError("depth of encoding 'yuv'")
        taken.append(colour)

    monkeypatch.setattr(SlamNode, "_process", slow)
    slam = SlamNode(load_ros())
    slam.receive(0, 0, 0)
    wait_for(lambda: slam._newest is None)
    for i in (1, 2, 3):  # while frame 0 is in hand
        slam.receive(i, i, i)
    wait_for(lambda: 3 in taken)
    slam.receive(4, 4, 4)
    wait_for(lambda: "depth of encoding 'yuv'; the frame is left out" in caplog.text)
    slam.close()
    assert (taken, slam.dropped) == ([0, 3], 2)
    assert "no results" in caplog.text
    assert visible_files(tmp_path) == []


@pytest.mark.parametrize(("encoding", "order"), [("rgb8", (2, 1, 0)), ("bgr8", (0, 1, 2)), ("rgba8", (2, 1, 0)), ("bgra8", (0, 1, 2))])
def test_colour_of_every_encoding(encoding: str, order: tuple[int, ...]) -> None:
    pixels = np.arange(2 * 3 * len(encoding[:-1]), dtype=np.uint8).reshape(2, 3, -1)
    assert (colour_of(image(pixels, encoding, padding=5)) == pixels[..., list(order)]).all()


def test_grey_and_depth() -> None:
    grey = np.array([[1, 2], [3, 4]], np.uint8)
    assert (colour_of(image(grey, "mono8")) == grey[..., None]).all()
    raw = np.array([[0, 1500], [65535, 7]], np.uint16)
    assert (depth_of(image(raw, "16UC1", padding=2), 1000) == raw).all()
    assert (depth_of(image(raw.astype(">u2"), "16UC1", bigendian=True), 1000) == raw).all()
    metres = np.array([[np.nan, 1.5], [np.inf, -1.0]], np.float32)
    assert (depth_of(image(metres, "32FC1"), 1000) == [[0, 1500], [0, 0]]).all()


def test_depth_keeps_its_stamp_and_parameters_state_the_times() -> None:
    colour, depth, info = box_messages(0)
    depth.header = SimpleNamespace(stamp=SimpleNamespace(sec=100, nanosec=7_000_000), frame_id="camera_optical")
    times = timing_of(Parameters(readout=0.02, depth_delay=-0.004))
    frame = frame_of(0, colour, depth, info, 1000, times)
    assert (frame.timestamp, frame.depth_timestamp) == (100.0, 100.007)
    assert frame.timing == times == SensorTiming(0.02, None, -0.004)
    assert frame_of(0, colour, depth, info, 1000).timing == SensorTiming(None, None, None)
    with pytest.raises(ConfigError, match=r"readout is 20\.0, expected seconds from 0 to 0\.5"):
        timing_of(Parameters(readout=20.0))


def test_what_cannot_be_a_frame() -> None:
    colour, depth, info = box_messages(0)
    with pytest.raises(FrameError, match="colour of encoding 'yuv422'"):
        colour_of(image(np.zeros((2, 2, 2), np.uint8), "yuv422"))
    with pytest.raises(FrameError, match="depth of encoding 'rgb8'"):
        depth_of(image(np.zeros((2, 2, 3), np.uint8), "rgb8"), 1000)
    with pytest.raises(FrameError, match="expected one size"):
        frame_of(0, colour, image(np.zeros((2, 2), np.uint16), "16UC1"), info, 1000)
    straight, bent = (frame_of(0, colour, depth, camera_info(d), 1000) for d in ((0.0,) * 5, (0.3, 0.0, 0.0, 0.0, 0.0)))
    assert straight.depth[0, 0] == pytest.approx(box_view(box_poses()[0])[1][0, 0] / 1000)
    assert (bent.depth != straight.depth).mean() > 0.5  # undistorted


def test_axes_of_the_map() -> None:
    T_wc = np.eye(4)
    T_wc[:3, 3] = [1, 2, 3]  # right, down, forward
    position, quaternion = pose_in_map(T_wc)
    assert position.tolist() == [3, -1, -2]
    assert np.allclose(np.abs(quaternion), 0.5)  # the optical frame of a camera that looks along x


def test_without_ros_one_line_is_told(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rclpy", None)
    with pytest.raises(ConfigError, match="no ROS 2 in this Python"):
        load_ros()
    with pytest.raises(SystemExit) as caught:
        main([])
    assert caught.value.code == 1
    assert capsys.readouterr().err.startswith("error: no ROS 2 in this Python")
