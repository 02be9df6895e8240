"""Colour and depth keep their stamps through every reader, every colour image is a frame, and a sensor's times go by precedence."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers.recordings import HEIGHT, WIDTH, write_folder, write_images, write_scannet, write_seven_scenes, write_tum
from helpers.ros_bags import DEPTH, recorded, write_bag
from helpers.shared_data import shared_recording
from helpers.videos import kinect_calibration, write_kinect
from idfslam.cli import command_line
from idfslam.datasets import Dataset, Kidnapped, Prefetch, Selection, open_recording
from idfslam.datasets.images.partners import of_frames, with_nearest
from idfslam.datasets.input_summary import shutter, summarise
from idfslam.datasets.recording import depth_timestamps, timing
from idfslam.errors import ConfigError, RecordingError
from idfslam.frame import Frame
from idfslam.geometry.sensor_timing import SYNCHRONISED, SensorTiming
from idfslam.live import open_live
from idfslam.live.recorder import record

UNKNOWN = SensorTiming(None, None, None)
LATE = 0.006  # [s] depth after colour, in the recordings below
STEP = 1 / 30  # [s]


def frames(recording: Dataset) -> list[Frame]:
    return [recording[i] for i in range(len(recording))]


def lags(recording: Dataset) -> list[float]:
    """[s] by which depth is later than colour, to a tenth of a millisecond."""
    return [round(frame.depth_lag, 4) + 0.0 for frame in frames(recording)]


def has_depth(recording: Dataset) -> list[bool]:
    return [bool(frame.depth.any()) for frame in frames(recording)]


def tum(path: Path, *, depths: tuple[int, ...] = (0, 1, 2, 3), late: float = LATE) -> Path:
    """Four colour images at 30 Hz, and the depth images of these frames."""
    write_tum(path, frames=4)
    lines = [f"{100 + i / 30 + late:.6f} depth/{100 + i / 30:.6f}.png" for i in depths]
    (path / "depth.txt").write_text("\n".join(lines) + "\n")
    return path


def associations(path: Path) -> Path:
    tum(path)
    stamps = [(f"{100 + i / 30:.6f}", f"{100 + i / 30 + LATE:.6f}") for i in range(4)]
    (path / "associations.txt").write_text("\n".join(f"{colour} rgb/{colour}.png {depth} depth/{colour}.png" for colour, depth in stamps))
    for name in ("rgb.txt", "depth.txt"):
        (path / name).unlink()
    return path


def named_by_stamps(path: Path) -> Path:
    for i in range(4):
        stamp = 1.7e9 + i / 30
        write_images(path / f"rgb/{stamp:.6f}.png", path / f"depth/{stamp + LATE:.6f}.png", i, 1000, (WIDTH, HEIGHT))
    (path / "intrinsics.txt").write_text("15 0 7.5\n0 15 5.5\n0 0 1\n")
    return path


def listed(path: Path) -> Path:
    write_folder(path, frames=4)
    lines = [f"{i} {5 + i / 30:.6f} {5 + i / 30 + LATE:.6f}" for i in range(4)]
    (path / "timestamps.txt").write_text("\n".join(["# number timestamp depth_timestamp", *lines, ""]))
    return path


RECORDINGS: dict[str, Callable[[Path], Path]] = {
    "tum": tum,
    "associations": associations,
    "named by stamps": named_by_stamps,
    "timestamps.txt": listed,
    "ROS 1": lambda path: write_bag(path.with_suffix(".bag"), recorded(4, late=LATE)),
    "ROS 2": lambda path: write_bag(path, recorded(4, late=LATE), "mcap"),
}


@pytest.mark.parametrize("name", RECORDINGS)
def test_depth_keeps_its_own_stamps(name: str, tmp_path: Path) -> None:
    recording = open_recording(RECORDINGS[name](tmp_path / "room"))
    assert lags(recording) == [LATE] * 4
    stamps = depth_timestamps(recording)
    assert stamps is not None and stamps.tolist() == [frame.depth_timestamp for frame in frames(recording)]
    assert timing(recording) == recording[0].timing == UNKNOWN


def test_a_third_column_without_that_header_may_be_anything(tmp_path: Path) -> None:
    path = listed(tmp_path / "room")
    (path / "timestamps.txt").write_text((path / "timestamps.txt").read_text().split("\n", 1)[1])
    recording = open_recording(path)
    assert lags(recording) == [0.0] * 4 and depth_timestamps(recording) is None


def test_the_stated_delay_of_an_azure_kinect(tmp_path: Path) -> None:
    """Its depth camera has a global shutter."""
    recording = open_recording(write_kinect(tmp_path / "room.mkv", calibration=kinect_calibration(), delay=0.03))
    assert lags(recording) == [0.03] * 3
    assert timing(recording) == recording[0].timing == SensorTiming(None, 0.0, None)


def test_selections_kidnapping_and_prefetch_keep_the_stamps(tmp_path: Path) -> None:
    recording = open_recording(tum(tmp_path / "room"), camera={"readout": 0.02})
    every_second = Selection(recording, start=1, stride=2)
    assert lags(every_second) == [LATE] * 2 and every_second.timing == SensorTiming(0.02, None, None)
    assert every_second.depth_timestamps is not None
    np.testing.assert_allclose(every_second.depth_timestamps, [100 + STEP + LATE, 100.1 + LATE], rtol=0, atol=1e-6)
    read = [frame for _, frame in Prefetch(every_second) if isinstance(frame, Frame)]
    assert [frame.depth_timestamp for frame in read] == every_second.depth_timestamps.tolist()
    taken = Kidnapped(recording, times=1, frames=2)
    assert taken.timing == SensorTiming(0.02, None, None) and taken.depth_timestamps is not None
    dark = taken.order < 0
    np.testing.assert_allclose(np.array(lags(taken))[~dark], LATE, atol=1e-9)
    np.testing.assert_allclose((taken.depth_timestamps - taken.timestamps)[~dark], LATE, atol=1e-6)
    assert np.isnan(taken.depth_timestamps[dark]).all() and dark.sum() == 2


# ----- every colour image is a frame


def test_the_nearest_depth_image() -> None:
    """Colour every 0.1 s: image 1 is 40 ms from the nearest depth image, 3 is 100 ms, 4 is 200 ms."""
    colour, depth = np.array([0.0, 0.1, 0.2, 0.3, 0.4]), np.array([0.0, 0.14, 0.2])
    assert with_nearest(np.array([[0, 0], [2, 2]]), colour, depth + 1e-9).tolist() == [0, 1, 2, 2, -1]
    assert with_nearest(np.array([[0, 0]]), colour[:1], depth).tolist() == [0]
    assert with_nearest(np.zeros((0, 2), np.int64), colour, np.array([np.nan])).tolist() == [-1] * 5
    assert of_frames(np.array([True, False, True]), np.arange(3.0)).tolist() == [0, -1, 2]  # seconds apart: another view
    assert of_frames(np.array([False, True, False, False]), np.arange(4) / 30).tolist() == [1, 1, 1, -1]
    assert of_frames(np.array([True, True]), np.array([0.0, np.nan])).tolist() == [0, 1]


def without(pattern: str, write: Callable[[Path], Path]) -> Callable[[Path], Path]:
    """The recording without the depth images whose files fit the pattern."""

    def changed(path: Path) -> Path:
        write(path)
        for file in path.glob(pattern):
            file.unlink()
        return path

    return changed


def bag_without(path: Path) -> Path:
    messages = [message for message in recorded(4) if message[0] != DEPTH or abs(message[1] - 100.125) < 1e-6 or message[1] < 100.03]
    return write_bag(path.with_suffix(".bag"), messages)


COLOUR_ALONE: dict[str, tuple[Callable[[Path], Path], list[float], list[bool]]] = {
    # [s] lag of depth, and which frames have depth: image 2 of 0 to 3 has no depth image of its own, or several have none
    "tum, one": (lambda path: tum(path, depths=(0, 1, 3)), [LATE, LATE, LATE - STEP, LATE], [True] * 4),
    "tum, all but one": (lambda path: tum(path, depths=(0,)), [LATE, LATE - STEP, 0, 0], [True, True, False, False]),
    "ROS": (bag_without, [0, -STEP, STEP, 0], [True] * 4),
    "named by stamps": (without("depth/1700000000.072667.png", named_by_stamps), [LATE, LATE, LATE - STEP, LATE], [True] * 4),
    "folder without stamps": (without("depth/000002.png", lambda path: write_folder(path, frames=4)), [0] * 4, [True, True, False, True]),
    "7-Scenes": (
        without("frame-000002.depth.png", lambda path: write_seven_scenes(path, frames=4)),
        [0] * 4,
        [True, True, False, True],
    ),
    "ScanNet": (without("depth/2.png", lambda path: write_scannet(path, frames=4)), [0] * 4, [True, True, False, True]),
}


@pytest.mark.parametrize("name", COLOUR_ALONE)
def test_a_colour_image_without_a_depth_image(name: str, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    write, expected, depth = COLOUR_ALONE[name]
    recording = open_recording(write(tmp_path / "room"))
    assert has_depth(recording) == depth
    np.testing.assert_allclose(lags(recording), expected, atol=1e-4)
    assert [round(float(frame.colour[6, 8, 0]) * 255) for frame in frames(recording)] == pytest.approx([10, 11, 12, 13], abs=2)
    alone = {"tum, all but one": 3, "ROS": 2}
    assert f"{alone.get(name, 1)} of 4 colour images have no depth image of their own; they take the nearest in time" in caplog.text


def test_a_recording_whose_depth_is_rare_opens(tmp_path: Path) -> None:
    """Of 40 colour images one has a depth image."""
    recording = write_folder(tmp_path / "room", frames=40)
    for i in range(40):
        if i != 13:
            (recording / f"depth/{i:06d}.png").unlink()
    assert np.flatnonzero(has_depth(open_recording(recording))).tolist() == [13]
    assert summarise(open_recording(recording)).median_depth == 1.0  # type: ignore[union-attr]


def test_depth_of_frames_whose_stamps_are_unusable(tmp_path: Path) -> None:
    path = without("depth/000002.png", lambda path: write_folder(path, frames=4))(tmp_path / "room")
    (path / "timestamps.txt").write_text("".join(f"{i} none\n" for i in range(4)))
    assert has_depth(open_recording(path)) == [True, True, False, True]


def test_the_first_frames_of_freiburg1_rpy() -> None:
    path = shared_recording("rgbd_dataset_freiburg1_rpy_first")
    colour = np.array([float(line.split()[0]) for line in (path / "rgb.txt").read_text().splitlines() if not line.startswith("#")])
    recording = open_recording(path)
    assert recording.timestamps.tolist() == colour.tolist() and len(recording) == 340
    stamps = depth_timestamps(recording)
    assert stamps is not None
    assert (np.abs(stamps - recording.timestamps) < 1.1 * STEP)[np.isfinite(stamps)].all() and np.isfinite(stamps).all()
    assert timing(recording) == SensorTiming(0.026, 0.036, None)  # those of the camera, which the folder's name tells
    assert timing(open_recording(path, camera={"readout": 0.0})) == SensorTiming(0.0, 0.036, None)


# ----- the sensor's times


def with_camera(path: Path, **times: Any) -> Path:
    write_folder(path)
    (path / "cam_params.json").write_text(json.dumps({"camera": times}))
    return path


def test_the_users_times_win_over_the_files(tmp_path: Path) -> None:
    path = with_camera(tmp_path / "room", readout=0.026, depth_delay=-0.009)
    assert timing(open_recording(path)) == SensorTiming(0.026, None, -0.009)
    assert open_recording(path).camera.fx == 15.0  # intrinsics.txt has the camera
    recording = open_recording(path, camera={"readout": 0.0, "depth_readout": 0.0})
    assert timing(recording) == recording[1].timing == SensorTiming(0.0, 0.0, -0.009)
    whole = {"fx": 16.0, "fy": 16.0, "cx": 7.5, "cy": 5.5}
    assert timing(open_recording(path, camera=whole)) == SensorTiming(0.026, None, -0.009)
    (path / "cam_params.json").write_text(json.dumps({"camera": whole | {"scale": 1000, "depth_readout": 0.03}}))
    assert timing(open_recording(path)) == SensorTiming(None, 0.03, None)
    assert open_recording(path).camera.fx == 16.0


def test_the_times_of_a_generated_recording_are_its_own() -> None:
    assert timing(open_recording("synthetic", frames=1)) == SYNCHRONISED
    with pytest.raises(ConfigError, match="has its own camera and depth"):
        open_recording("synthetic", frames=1, camera={"readout": 0.02})


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("readout", 26, "readout is 26.*, expected seconds from 0 to 0.5"),
        ("depth_readout", -0.01, "depth_readout is -0.01, expected seconds from 0 to 0.5"),
        ("depth_delay", float("nan"), "depth_delay is nan, expected seconds from -0.5 to 0.5"),
    ],
)
def test_times_that_are_no_sensors(name: str, value: float, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_folder(tmp_path / "room")
    with pytest.raises(ConfigError, match=message) as caught:
        open_recording(path, camera={name: value})
    assert "\n" not in str(caught.value)
    with pytest.raises(SystemExit) as ended:
        command_line.main(["run", str(path), f"--camera.{name.replace('_', '-')}", str(value), "--out", str(tmp_path / "out")])
    assert ended.value.code in (1, 2) and "Traceback" not in capsys.readouterr().err
    with_camera(tmp_path / "other", **{name: value})
    with pytest.raises(RecordingError, match=message if value == value else "NaN|nan"):
        open_recording(tmp_path / "other")


def test_what_is_known_in_a_few_words(tmp_path: Path) -> None:
    assert shutter(UNKNOWN) == "unknown shutter"
    assert shutter(SYNCHRONISED) == "global shutter"
    assert shutter(SensorTiming(None, 0.0, None)) == "colour unknown shutter, depth global shutter"
    assert shutter(SensorTiming(0.026, 0.0305, -0.009)) == "colour read-out of 26 ms, depth read-out of 30 ms, depth 9 ms before its stamps"
    summary = summarise(open_recording(with_camera(tmp_path / "room", readout=0.026, depth_readout=0.026)))
    assert summary is not None and str(summary).endswith("frames/s (assumed), read-out of 26 ms")
    values = summary.to_dict()
    assert [values[name] for name in ("readout_s", "depth_readout_s", "depth_delay_s")] == [0.026, 0.026, None]


# ----- live


def test_a_camera_that_is_recorded_keeps_stamps_and_times(tmp_path: Path) -> None:
    path = tum(tmp_path / "room", depths=(0, 1, 3))
    times = {"readout": 0.02, "depth_readout": 0.0}
    record(open_live(f"replay@0.5:{path}", camera=times), tmp_path / "copy", png=True)
    source, copy = open_recording(path, camera=times), open_recording(tmp_path / "copy")
    assert timing(copy) == copy[0].timing == SensorTiming(0.02, 0.0, None)
    assert lags(copy) == lags(source) == [LATE, LATE, round(LATE - STEP, 4), LATE]
    assert copy.timestamps == pytest.approx(source.timestamps, abs=1e-6)
    assert (tmp_path / "copy" / "timestamps.txt").read_text().split("\n")[0] == "# number timestamp depth_timestamp"
