"""Live cameras as streams and through runs: the newest frames win, drops are counted, and a camera that goes leaves results."""

import gc
import json
import os
import shutil
import signal
import threading
import weakref
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from helpers.box_room import BOX_FRAMES, box_poses
from helpers.live_cameras import HandFed, PulledOut, SeeingSlam, SlowSlam, capture
from helpers.visible_files import visible_files
from idfslam.cli import command_line
from idfslam.config import FAST, Config
from idfslam.datasets import open_recording
from idfslam.errors import CameraError, ConfigError, FrameError
from idfslam.frame import Frame, FrameResult, Status
from idfslam.geometry.trajectory import load_tum
from idfslam.live import Capture, LiveStream, absolute_path, is_live, open_live
from idfslam.runs import result_folder
from idfslam.runs.evaluate_run import evaluate_folder
from idfslam.runs.run_config import RecordingSource, read_config
from idfslam.runs.runner import RunResult, run
from idfslam.runs.source import open_feed
from idfslam.slam import Slam
from idfslam.slam.warm_up import made_up_frames
from idfslam.storage.ledger import Ledger


def run_live(name: str, folder: Path, slam: Any = SeeingSlam) -> RunResult:
    source = RecordingSource(name)
    return run(open_feed(source), FAST, folder, source=source, make_slam=slam)


def metrics_of(folder: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((folder / result_folder.METRICS).read_text())
    return found


def test_a_slow_consumer_gets_the_newest_frame() -> None:
    device = HandFed()
    stream = LiveStream(device)
    frames = iter(stream)
    threading.Thread(target=device.give, args=(capture(10),)).start()
    assert next(frames)[1].timestamp == 10
    device.give(capture(11), capture(12), capture(13))
    index, frame = next(frames)
    assert isinstance(frame, Frame)
    assert (index, frame.index, frame.timestamp) == (1, 1, 13)
    assert frame.colour[0, 0, 0] == pytest.approx(0.13)
    assert stream.dropped == 2  # 11 and 12
    device.give(capture(14), capture(15), None)
    assert [frame.timestamp for _, frame in frames] == [15]
    assert stream.dropped == 3
    assert stream.timestamps.tolist() == [10, 13, 15]
    assert stream.ground_truth is None
    assert stream.failure is None
    assert device.closed


def test_memory_is_bounded() -> None:
    device = HandFed()
    frames = iter(LiveStream(device))
    threading.Thread(target=device.give, args=(capture(0),)).start()
    next(frames)
    given = []
    for stamp in range(1, 51):
        one = capture(stamp)
        given.append(weakref.ref(one))
        device.give(one)
    del one
    gc.collect()
    assert sum(ref() is not None for ref in given) == 1  # the newest, waiting
    device.give(None)
    assert len(list(frames)) == 1


def test_the_same_images_again_are_no_frame() -> None:
    device = HandFed()
    stream = LiveStream(device)
    threading.Thread(target=device.give, args=(capture(1), capture(1), capture(1), None)).start()
    assert len(list(stream)) == 1
    assert stream.dropped == 0


def test_it_ends_after_so_many_frames() -> None:
    device = HandFed()
    frames = iter(LiveStream(device, frames=1))
    threading.Thread(target=device.give, args=(capture(1),)).start()
    next(frames)
    device.give(capture(2))
    threading.Thread(target=device.give, args=(None,)).start()
    assert list(frames) == []
    assert device.closed


def test_a_frame_that_cannot_be_used_is_handed_on() -> None:
    def retrieve(index: int) -> Frame:
        raise FrameError("no picture")

    device = HandFed()
    threading.Thread(target=device.give, args=(Capture(1.0, retrieve), None)).start()
    ((index, error),) = LiveStream(device)
    assert index == 0
    assert isinstance(error, FrameError)


def test_a_camera_that_gives_nothing_is_an_error() -> None:
    device = HandFed()
    threading.Thread(target=device.give, args=(CameraError("it is gone"),)).start()
    with pytest.raises(CameraError, match="it is gone"):
        list(LiveStream(device))
    with pytest.raises(CameraError, match=r"no images for 0\.05 s"):
        list(LiveStream(HandFed(), timeout=0.05))


def test_an_error_of_the_program_is_not_taken_for_the_end() -> None:
    device = HandFed()
    threading.Thread(target=device.give, args=(capture(1), ZeroDivisionError("a mistake"))).start()
    with pytest.raises(ZeroDivisionError, match="a mistake"):
        list(LiveStream(device))


def test_a_replay_keeps_pace_stamps_and_truth(box_recording: Path) -> None:
    stream = open_live(f"replay@0.5:{box_recording}", frames=3, start=2)
    assert stream.camera == open_recording(box_recording).camera
    frames = [frame for _, frame in stream]
    assert [frame.index for frame in frames if isinstance(frame, Frame)] == [0, 1, 2]
    assert np.allclose(stream.timestamps, np.array([2, 3, 4]) / 30)
    assert stream.ground_truth is not None
    assert np.allclose(stream.ground_truth, box_poses()[2:5])
    assert stream.dropped == 0


@pytest.mark.slow
def test_a_run_that_keeps_up(box_recording: Path, tmp_path: Path) -> None:
    done = run_live(f"replay@0.5:{box_recording}", tmp_path)
    assert visible_files(tmp_path) == sorted(result_folder.FILES)
    assert len(done.trajectory) == BOX_FRAMES
    assert metrics_of(tmp_path)["dropped_frames"] == 0
    assert metrics_of(tmp_path)["ate_m"]["rmse"] < 1e-6


@pytest.mark.slow
def test_a_run_that_does_not_keep_up_drops_and_counts(box_recording: Path, tmp_path: Path) -> None:
    done = run_live(f"replay:{box_recording}", tmp_path, SlowSlam)  # 0.43 s of recording, 0.1 s a frame
    metrics = metrics_of(tmp_path)
    assert 3 <= metrics["frames"] <= 6
    assert metrics["frames"] + metrics["dropped_frames"] == BOX_FRAMES
    assert (metrics["camera_lost"], metrics["interrupted"]) == (False, False)
    assert metrics["ate_m"]["rmse"] < 1e-6  # each pose against the truth of its own moment
    stamps = load_tum(tmp_path / result_folder.TRAJECTORY).timestamps
    assert np.allclose(stamps, done.trajectory.timestamps, atol=1e-6)
    assert stamps[-1] == pytest.approx((BOX_FRAMES - 1) / 30, abs=1e-6)  # the last frame is not lost
    assert np.diff(stamps).max() < 0.2  # never far behind
    evaluation = evaluate_folder(tmp_path)
    assert evaluation.frames == metrics["frames"]
    assert evaluation.ate is not None
    assert evaluation.ate.translation.rmse < 1e-6


def test_a_bad_frame_of_a_replay_is_lost(box_recording: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    recording = shutil.copytree(box_recording, tmp_path / "bad")
    (recording / "depth" / "0004.png").write_bytes(b"no image")
    run_live(f"replay@0.5:{recording}", tmp_path / "out")
    assert metrics_of(tmp_path / "out")["unreadable_frames"] == 1
    assert "the frame is treated as lost" in caplog.text


def test_ctrl_c_writes_the_results_so_far(box_recording: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    class Interrupted(SeeingSlam):
        made = 0

        def __init__(self, config: Config) -> None:
            super().__init__(config)
            Interrupted.made += 1

        def process(self, frame: Frame) -> FrameResult:
            if Interrupted.made == 2 and frame.index == 2:  # the first one is for warming up
                os.kill(os.getpid(), signal.SIGINT)
            return super().process(frame)

    done = run_live(f"replay@0.5:{box_recording}", tmp_path, Interrupted)
    assert len(done.trajectory) == 3
    assert metrics_of(tmp_path)["interrupted"] is True
    assert "interrupted after frame 2: writing" in caplog.text
    assert visible_files(tmp_path) == sorted(result_folder.FILES)


def test_a_camera_that_is_pulled_out_leaves_results(box_recording: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    stream = LiveStream(PulledOut(open_recording(box_recording), after=5))
    done = run(stream, FAST, tmp_path, make_slam=SeeingSlam)
    assert 4 <= len(done.trajectory) <= 5  # one may have been overtaken
    assert metrics_of(tmp_path)["camera_lost"] is True
    assert "the cable is out; the camera counts as disconnected after" in caplog.text
    assert (tmp_path / result_folder.MESH).is_file()


def test_a_camera_that_never_gave_a_frame_leaves_the_folder_alone(box_recording: Path, tmp_path: Path) -> None:
    (tmp_path / result_folder.MESH).write_text("of an earlier run")
    Ledger(tmp_path).record([result_folder.MESH])
    with pytest.raises(CameraError, match="the cable is out"):
        run(LiveStream(PulledOut(open_recording(box_recording), after=0)), FAST, tmp_path, make_slam=SeeingSlam, overwrite=True)
    assert visible_files(tmp_path) == [result_folder.MESH]
    assert (tmp_path / result_folder.MESH).read_text() == "of an earlier run"


def test_progress_without_a_total(box_recording: Path, tmp_path: Path) -> None:
    console = Console(width=140, force_terminal=True, record=True, file=(tmp_path / "out.txt").open("w"))
    run(open_live(f"replay@0.5:{box_recording}", frames=3), FAST, tmp_path / "out", console=console, make_slam=SeeingSlam)
    shown = console.export_text()
    assert "hold the camera still" in shown
    assert "3/?" in shown


@pytest.mark.slow
def test_a_replay_through_the_command_line(
    box_recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(box_recording.parent)
    command_line.main(
        [
            "run",
            "replay:box",
            "--frames",
            "3",
            "--out",
            str(tmp_path),
            "--device",
            "cpu",
            "--mesh.resolution",
            "0.1",
            "--refinement.updates",
            "0",
        ]
    )
    assert metrics_of(tmp_path)["ate_m"]["rmse"] < 0.05
    assert read_config(tmp_path)[1] == RecordingSource(f"replay:{box_recording}", frames=3)
    monkeypatch.chdir(tmp_path)
    command_line.main(["eval", str(tmp_path)])
    assert "ATE" in capsys.readouterr().out


def test_the_made_up_frames_use_all_that_a_run_does() -> None:
    slam = Slam(FAST)
    *statuses, last = [slam.process(frame).status for frame in made_up_frames()]
    assert (statuses, last) == ([Status.OK] * 11, Status.DOUBTFUL)
    assert {"map", "align", "track"} <= slam.timings.keys()  # the last one was doubted


def test_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert all(map(is_live, ("realsense", "realsense:12", "opencv:0:2", "openni", "orbbec:1", "replay:a/b:c", "replay@2:a")))
    assert not any(map(is_live, ("synthetic:3", "C:/recordings/a", "realsense2", "my_realsense", "/data/replay")))
    (tmp_path / "realsense").mkdir()
    assert not is_live("realsense")  # a folder of that name
    (tmp_path / "a").mkdir()
    assert absolute_path("replay@2:a") == f"replay@2:{tmp_path / 'a'}"
    assert absolute_path("a") == str(tmp_path / "a")
    assert absolute_path("replay:synthetic") == "replay:synthetic"
    assert absolute_path("openni") == "openni"


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("replay", {}, "expected replay:PATH"),
        ("replay@fast:synthetic", {}, "expected a number above 0"),
        ("replay@0:synthetic", {}, "expected a number above 0"),
        ("realsense@2", {}, "not a live camera"),
        ("opencv:0", {}, "expected opencv:COLOUR:DEPTH"),
        ("openni:first", {}, "expected the number of a device"),
        ("opencv:0:2", {"start": 5}, "leave --start, --stride, --format and --topics out"),
        ("opencv:0:2", {"frames": 0}, "expected at least 1"),
        ("realsense", {"camera": {"fx": 500.0}}, "the device tells its own camera"),
    ],
)
def test_wrong_names(name: str, options: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        open_live(name, **options)


def test_a_camera_that_is_not_there(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        command_line.main(["run", "opencv:97:98"])
    assert caught.value.code == 1
    assert capsys.readouterr().err == "error: video device 97: not there or in use, expected a camera (Linux: ls /dev/video*)\n"
