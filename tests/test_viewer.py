"""What the viewer keeps of a run, read back from recording.rrd; and how it says no."""

import socket
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from helpers.box_room import BOX_FRAMES, box_poses
from helpers.known_slam import DEGENERATE, LOST, KnownSlam
from helpers.rerun_viewer import NO_RERUN, viewer
from idfslam.cli import command_line
from idfslam.config import FAST
from idfslam.datasets import open_recording
from idfslam.errors import ConfigError, DivergedError, ResultError
from idfslam.frame import Frame, FrameResult, Status
from idfslam.geometry.camera import Camera
from idfslam.runs import result_folder
from idfslam.runs.runner import run
from idfslam.storage.ledger import Ledger
from idfslam.viewer import rerun_program
from idfslam.viewer.coloured_path import coloured_strips
from idfslam.viewer.frustums import frustums
from idfslam.viewer.recorded_view import show
from idfslam.viewer.rerun_viewer import RerunViewer
from idfslam.viewer.viewer import NullViewer


def read(folder: Path) -> tuple[Counter[str], list[Any]]:
    """Rows of each entity, and the chunks."""
    chunks = list(pytest.importorskip("rerun.chunk", reason=NO_RERUN).RrdReader(folder / result_folder.RECORDING).stream())
    rows: Counter[str] = Counter()
    for chunk in chunks:
        rows[chunk.entity_path] += chunk.num_rows
    return rows, chunks


def values(chunks: list[Any], entity: str, component: str) -> list[Any]:
    """All rows of a component, in the order of frames."""
    rows: list[tuple[int, Any]] = []
    for chunk in chunks:
        if chunk.entity_path == entity and not chunk.is_static:
            batch = chunk.to_record_batch().to_pydict()
            rows += zip(batch["frame"], batch[component])
    return [value for _, value in sorted(rows, key=lambda row: row[0])]


@pytest.fixture(scope="module")
def recorded(box_recording: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The result folder of a run before a viewer; not to be changed."""
    folder = tmp_path_factory.mktemp("viewed")
    run(open_recording(box_recording), FAST, folder, make_slam=KnownSlam, viewer=viewer())  # type: ignore[arg-type]
    return folder


def test_every_frame_has_a_pose_and_every_number_its_place(recorded: Path) -> None:
    rows, chunks = read(recorded)
    assert rows["/world/camera"] == rows["/milliseconds/track"] == BOX_FRAMES
    assert rows["/losses/sdf"] == 3  # keyframes 0, 5, 10
    assert 1 <= rows["/world/camera/image/colour"] == rows["/world/camera/image/depth"] <= BOX_FRAMES
    assert rows["/world/keyframes"] == rows["/world/graph/covisible"] == rows["/world/graph/loop"] >= 2  # the first frame, and the end
    assert rows["/world/mesh"] >= 2
    assert values(chunks, "/milliseconds/track", "Scalars:scalars") == [[5.0]] * BOX_FRAMES  # two calls a frame: 2 ms and 3 ms
    assert values(chunks, "/milliseconds/map", "Scalars:scalars")[:6] == [[70.0], [0.0], [0.0], [0.0], [0.0], [70.0]]
    assert values(chunks, "/losses/sdf", "Scalars:scalars") == [[pytest.approx(0.5 / i)] for i in (1, 6, 11)]


def test_poses_and_graph_come_back(recorded: Path) -> None:
    _, chunks = read(recorded)
    truth = (np.linalg.inv(box_poses()[0]) @ box_poses())[:, :3, 3]
    translations = values(chunks, "/world/camera", "Transform3D:translation")
    assert np.allclose(np.array(translations)[:, 0], truth, atol=1e-6)
    edges = values(chunks, "/world/graph/covisible", "LineStrips3D:strips")[-1]
    assert np.allclose(edges, [truth[[0, 5]], truth[[5, 10]]], atol=1e-6)
    assert len(values(chunks, "/world/keyframes", "LineStrips3D:strips")[-1]) == 3
    path = values(chunks, "/world/trajectory", "LineStrips3D:strips")[-1]
    assert [len(strip) for strip in path] == [6, 2, 3, 2, 5]  # ok, lost, ok, degenerate, ok; each begins where the last one ended


def test_the_status_is_told_where_it_changes(recorded: Path) -> None:
    _, chunks = read(recorded)
    assert (LOST, DEGENERATE) == (6, 9)
    states = values(chunks, "/status", "StateChange:state")
    assert states == [["ok"], ["lost"], ["ok"], ["degenerate"], ["ok"]]


def test_the_layout_lies_in_the_file(recorded: Path) -> None:
    reader = pytest.importorskip("rerun.chunk", reason=NO_RERUN).RrdReader(recorded / result_folder.RECORDING)
    assert len(reader.recordings()) == len(reader.blueprints()) == 1
    assert not [path for path in recorded.iterdir() if path.name.startswith(".part")]


def test_loops_are_told_once_and_drawn(box_recording: Path, tmp_path: Path) -> None:
    seen, slam = viewer(), KnownSlam(FAST)
    with seen.opened(tmp_path, "box"):
        for i, frame in enumerate(open_recording(box_recording)):
            result = slam.process(frame)
            slam.closed = [SimpleNamespace(a=0, b=2)] if i >= 11 else []
            seen.frame(frame, result, slam)
        seen.finish(slam, slam.mesh(0.1))
    _, chunks = read(tmp_path)
    assert values(chunks, "/events", "TextLog:text") == [["loop closed between frames 0 and 10"]]
    assert [len(edges or []) for edges in values(chunks, "/world/graph/loop", "LineStrips3D:strips")][-2:] == [1, 1]  # at once, and the end


def test_a_run_that_fails_keeps_what_was_shown(box_recording: Path, tmp_path: Path) -> None:
    class Diverging(KnownSlam):
        def process(self, frame: Frame) -> FrameResult:
            if frame.index == 6:
                raise DivergedError("the map's loss at keyframe 6 is nan")
            return super().process(frame)

    with pytest.raises(DivergedError):
        run(open_recording(box_recording), FAST, tmp_path, make_slam=Diverging, viewer=viewer())  # type: ignore[arg-type]
    assert read(tmp_path)[0]["/world/camera"] == 6


def test_a_run_without_a_viewer_leaves_no_recording_of_an_earlier_one(box_recording: Path, tmp_path: Path) -> None:
    (tmp_path / result_folder.RECORDING).write_bytes(b"earlier")
    Ledger(tmp_path).record([result_folder.RECORDING])
    run(open_recording(box_recording), FAST, tmp_path, make_slam=KnownSlam, viewer=NullViewer(), overwrite=True)  # type: ignore[arg-type]
    assert not (tmp_path / result_folder.RECORDING).exists()


def test_a_viewer_changes_nothing(box_recording: Path, tmp_path: Path) -> None:
    small = replace(
        FAST,
        field=replace(FAST.field, table_log2=13),
        mapper=replace(FAST.mapper, pixels=256, first_iterations=60),
        refinement=replace(FAST.refinement, updates=2),
        mesh=replace(FAST.mesh, resolution=0.1),
    )
    shown = viewer()
    recording = open_recording(box_recording, frames=8)
    poses = [run(recording, small, tmp_path / name, viewer=each).trajectory.poses for name, each in (("a", NullViewer()), ("b", shown))]
    assert np.array_equal(*poses)


def test_strips_of_one_status() -> None:
    positions = np.arange(15.0).reshape(5, 3)
    strips, kinds = coloured_strips(positions, [Status.OK, Status.OK, Status.LOST, Status.LOST, Status.OK])
    assert kinds == [Status.OK, Status.LOST, Status.OK]
    assert [strip[:, 0].tolist() for strip in strips] == [[0, 3], [3, 6, 9], [9, 12]]
    assert coloured_strips(np.zeros((0, 3)), []) == ([], [])


def test_frustums_begin_at_the_camera_and_look_along_z() -> None:
    T_wk = np.eye(4)[None].repeat(2, 0)
    T_wk[1, :3, 3] = 1, 2, 3
    edges = frustums(T_wk, [Camera(100, 80, 50.0, 50.0, 49.5, 39.5), Camera(50, 50, 50.0, 50.0, 24.5, 24.5)])
    assert edges.shape == (2, 11, 3)
    assert np.allclose(edges[:, 0], [[0, 0, 0], [1, 2, 3]])
    assert np.allclose(edges[0, 1], [-0.08, -0.064, 0.08])  # the image's outer corner is one focal length to the left, 0.8 above
    assert np.allclose(edges[1, 1] - edges[1, 0], [-0.04, -0.04, 0.08])  # the other camera's


@contextmanager
def listening() -> Iterator[int]:
    with socket.socket() as server:
        server.bind(("0.0.0.0", 0))
        server.listen()
        yield server.getsockname()[1]


def test_a_port_in_use(box_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("rerun", reason=NO_RERUN)
    with listening() as port, pytest.raises(SystemExit) as caught:
        command_line.main(["run", str(box_recording), "--out", str(tmp_path / "out"), "--viewer", "web", "--port", str(port)])
    assert caught.value.code == 1
    message = capsys.readouterr().err.splitlines()[-1]  # the line before says what the recording was taken to be
    assert f"port {port} cannot be used" in message
    assert "--port" in message
    assert not (tmp_path / "out").exists()  # said before the run
    with pytest.raises(ConfigError, match="port 70000"):
        RerunViewer("web", port=70000)


def test_without_rerun(monkeypatch: pytest.MonkeyPatch, recorded_folder: Path) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    for attempt in (lambda: RerunViewer("file"), lambda: show(recorded_folder, web=True)):
        with pytest.raises(ConfigError, match="-m pip install rerun-sdk"):
            attempt()


@pytest.fixture
def recorded_folder(tmp_path: Path) -> Path:
    (tmp_path / result_folder.RECORDING).write_bytes(b"")
    return tmp_path


def test_without_a_display_there_is_no_window(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("rerun", reason=NO_RERUN)
    monkeypatch.setattr("idfslam.viewer.rerun_program.has_display", lambda: False)
    with pytest.raises(ConfigError, match="--viewer web"):
        RerunViewer("window")


def test_a_folder_without_a_recording(tmp_path: Path) -> None:
    with pytest.raises(ResultError, match=r"has no recording\.rrd; expected the results of `idf-slam run PATH --viewer`"):
        show(tmp_path, web=True)
    with pytest.raises(ResultError, match="no such folder"):
        show(tmp_path / "missing", web=True)


def test_viewer_with_and_without_a_place() -> None:
    def place(*arguments: str) -> str:
        command = command_line.parse(["run", *arguments])
        assert isinstance(command, command_line.Run)
        assert command.path == Path("recording")
        return command.live_view.viewer

    assert place("recording") == "none"
    assert place("recording", "--viewer") == "auto"
    assert place("--viewer", "recording") == "auto"
    assert place("recording", "--viewer", "--seed", "1") == "auto"
    assert place("recording", "--viewer", "web", "--port", "9000") == place("recording", "--viewer=web") == "web"


def test_the_live_view_listens_on_this_machine_alone() -> None:
    assert rerun_program.listening(90, rerun_program.LOOPBACK) == "listening on 127.0.0.1, ports 90 (page) and 91 (data)"
    assert "every machine that reaches this address can look on" in rerun_program.listening(90, "0.0.0.0")


def test_rerun_sends_no_usage_statistics(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("CI", raising=False)
    assert rerun_program.environment()["CI"] == "true"


def test_page_and_data_are_bound_to_the_chosen_address(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rerun_program, "program", lambda: "rerun")
    command = rerun_program.serve_command(90, "127.0.0.1", "recording.rrd")
    assert command[:5] == ["rerun", "recording.rrd", "--serve-web", "--bind", "127.0.0.1"]
    assert command[5:9] == ["--web-viewer-port", "90", "--port", "91"]
