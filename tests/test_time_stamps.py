"""Stamps become seconds that increase, whatever unit and faults they have; what was done is said in one line."""

from pathlib import Path

import numpy as np
import pytest

from helpers.recordings import write_folder, write_tum
from idfslam.datasets import open_recording
from idfslam.datasets.time_stamps import in_seconds, increasing, units_per_second
from idfslam.errors import RecordingError

VIDEO = np.arange(20) / 30  # [s]


@pytest.mark.parametrize("start", [0.0, 12.5, 5e5, 1.7e9])
@pytest.mark.parametrize("rate", [2, 10, 30, 90])
@pytest.mark.parametrize("unit", [1.0, 1e3, 1e6, 1e9])
def test_the_unit_is_recognised(start: float, rate: float, unit: float) -> None:
    stamps = start + np.arange(20) / rate
    assert units_per_second(np.round(stamps * unit) if unit > 1 else stamps) == unit


@pytest.mark.parametrize("unit", [1.0, 1e3, 1e6, 1e9])
def test_a_single_frame_is_recognised_by_the_years_since_1970(unit: float) -> None:
    assert units_per_second(np.array([1.7e9 * unit])) == unit


def test_slow_recordings_stay_in_seconds() -> None:
    assert units_per_second(np.arange(10.0)) == units_per_second(1.7e9 + 60 * np.arange(10.0)) == units_per_second(np.zeros(0)) == 1.0
    assert units_per_second(np.array([np.nan, 0.0, 0.0, 0.1])) == 1.0


def test_the_conversion_is_said_in_one_line(caplog: pytest.LogCaptureFixture) -> None:
    np.testing.assert_allclose(in_seconds(np.round(VIDEO * 1e9), "rgb.txt"), VIDEO, atol=1e-8)
    assert caplog.messages == ["rgb.txt: the stamps are taken for nanoseconds, and converted to seconds"]
    in_seconds(np.round(VIDEO * 1e9))
    assert in_seconds(VIDEO, "rgb.txt") is VIDEO
    assert len(caplog.messages) == 1


@pytest.mark.parametrize(("place", "value"), [(7, np.nan), (7, np.inf), (7, VIDEO[6]), (7, VIDEO[3]), (7, 99.0), (0, 99.0), (19, -5.0)])
def test_a_wrong_stamp_is_interpolated(place: int, value: float, caplog: pytest.LogCaptureFixture) -> None:
    stamps = VIDEO.copy()
    stamps[place] = value
    np.testing.assert_allclose(increasing(stamps, "room"), VIDEO, atol=1e-9)  # type: ignore[arg-type]
    assert caplog.messages == [
        f"room: 1 of 20 stamps are missing, or not later than the one before (the first at frame {place}); they are interpolated"
    ]


def test_a_clock_that_was_set_back_goes_on(caplog: pytest.LogCaptureFixture) -> None:
    repaired = increasing(np.concatenate([VIDEO[:13] + 100, VIDEO[:7]]), "room")
    np.testing.assert_allclose(repaired, VIDEO + 100)  # type: ignore[arg-type]


@pytest.mark.parametrize("stamps", [np.zeros(20), np.full(20, np.nan), -VIDEO])
def test_stamps_that_say_nothing_are_given_up(stamps: np.ndarray, caplog: pytest.LogCaptureFixture) -> None:
    assert increasing(stamps, "room") is None
    assert caplog.messages[0].endswith("; 30 frames/s are assumed")


def test_good_stamps_stay_as_they_are(caplog: pytest.LogCaptureFixture) -> None:
    assert increasing(VIDEO, "room") is VIDEO
    assert caplog.messages == []


def test_lists_that_go_backward_are_sorted_with_a_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    folder = write_tum(tmp_path / "kitchen")
    for name in ("rgb.txt", "depth.txt"):
        lines = [line for line in (folder / name).read_text().splitlines() if not line.startswith("#")]
        (folder / name).write_text("\n".join([lines[1], lines[0], *lines[2:]]))
    stamps = open_recording(folder).timestamps
    assert (np.diff(stamps) > 0).all()
    assert "rgb.txt: 1 stamps are earlier than the one in the line before; the images are sorted by their stamps" in caplog.text


def test_lists_of_two_units(tmp_path: Path) -> None:
    folder = write_tum(tmp_path / "kitchen")
    expected = open_recording(folder).timestamps
    rows = [line.split() for line in (folder / "depth.txt").read_text().splitlines() if not line.startswith("#")]
    (folder / "depth.txt").write_text("\n".join(f"{1000 * float(stamp):.0f} {file}" for stamp, file in rows))
    np.testing.assert_array_equal(open_recording(folder).timestamps, expected)


@pytest.mark.parametrize("line", ["rgb/{:06d}.png {}", "{:06d}.png,{}", "{} {}"], ids=["path", "name", "number"])
@pytest.mark.parametrize("dates", [False, True])
def test_frames_of_timestamps_txt_are_numbers_or_images(line: str, dates: bool, tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "kitchen")
    stamps = ["2023-05-01T12:30:59.90Z", "2023-05-01T12:31:00.00Z", "2023-05-01T12:31:00.10Z"] if dates else ["5.0", "5.1", "5.2"]
    stamps = [stamp.replace("0Z", "00") for stamp in stamps]  # Python 3.10 wants three digits
    (folder / "timestamps.txt").write_text("".join(line.format(i, stamp) + "\n" for i, stamp in enumerate(stamps)))
    expected = 1682944259.9 + 0.1 * np.arange(3) if dates else [5.0, 5.1, 5.2]
    np.testing.assert_allclose(open_recording(folder).timestamps, expected, rtol=0, atol=1e-5)


def test_timestamps_txt_without_a_frame_is_named(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "kitchen")
    (folder / "timestamps.txt").write_text("")
    with pytest.raises(RecordingError, match=r"timestamps\.txt: names none of the 3 colour images, expected lines of frame and stamp"):
        open_recording(folder)
