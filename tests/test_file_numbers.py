"""Which number of a file name counts the files, and which names are time stamps."""

from datetime import datetime, timedelta

import numpy as np
import pytest

from idfslam.datasets.images.file_numbers import counting_numbers, name_stamps


@pytest.mark.parametrize(
    ("names", "numbers"),
    [
        (["000001", "000002"], ["000001", "000002"]),
        (["frame-000001.color", "frame-000002.color"], ["000001", "000002"]),
        (["000012_color_640x480", "000013_color_640x480"], ["000012", "000013"]),
        (["000012_color_640_480", "000013_color_640_480"], ["000012", "000013"]),
        (["1_camera2", "3_camera2"], ["1", "3"]),
        (["0001_run1", "0002_run1", "0003_run2"], ["0001", "0002", "0003"]),  # run is no number of its own for each file
        (["cam0_17_a9", "cam0_18_a9"], ["17", "18"]),
        (["000012_color_640x480"], ["000012"]),
        (["1403636579_763555584", "1403636579_813555455"], ["1403636579.763555584", "1403636579.813555455"]),
        (["rig_Color_1694012345678.123", "rig_Color_1694012345711.456"], ["1694012345678.123", "1694012345711.456"]),
        (["a", "b"], [None, None]),
        (["0001", "0002", "calibration_3_4"], ["0001", "0002", "4"]),
        ([], []),
    ],
)
def test_the_number_that_counts_a_series(names: list[str], numbers: list[str | None]) -> None:
    assert counting_numbers(names) == numbers


FRAMES = np.arange(5) / 30
STAMPS = {
    "seconds since 1970": ([f"{1.7e9 + t:.6f}" for t in FRAMES], 1.7e9 + FRAMES),
    "milliseconds since 1970": ([f"color_{round(1.7e12 + 1e3 * t)}" for t in FRAMES], 1.7e9 + FRAMES),
    "microseconds since 1970": ([f"{round(1.7e15 + 1e6 * t)}" for t in FRAMES], 1.7e9 + FRAMES),
    "nanoseconds since 1970": ([f"{1700000000 * 10**9 + round(1e9 * t)}" for t in FRAMES], 1.7e9 + FRAMES),
    "seconds and nanoseconds": ([f"1700000000_{round(1e9 * t):09d}" for t in FRAMES], 1.7e9 + FRAMES),
    "milliseconds since 1970 with decimals": ([f"_Color_{1.7e12 + 1e3 * t:.3f}" for t in FRAMES], 1.7e9 + FRAMES),
    "seconds of a camera's clock": ([f"{12 + t:.6f}" for t in FRAMES], 12 + FRAMES),
    "milliseconds of a camera's clock": ([f"_Color_{1694.123 + 1e3 * t:.3f}" for t in FRAMES], 1.694123 + FRAMES),
    "whole milliseconds of a camera's clock": ([f"{round(1e3 * t)}" for t in FRAMES], FRAMES),
    "microseconds of a camera's clock": ([f"{33333 * i}" for i in range(5)], FRAMES),
    "nanoseconds of a camera's clock": ([f"{33333333 * i}" for i in range(5)], FRAMES),
    "a counter and a stamp": ([f"{i:06d}_{1.7e9 + t:.6f}" for i, t in enumerate(FRAMES)], 1.7e9 + FRAMES),
}


@pytest.mark.parametrize("clock", STAMPS)
def test_names_that_are_time_stamps(clock: str) -> None:
    names, expected = STAMPS[clock]
    stamps = name_stamps(names)
    assert stamps is not None
    np.testing.assert_allclose(stamps, expected, rtol=0, atol=6e-4)


@pytest.mark.parametrize(
    "names",
    [
        ["000000", "000001", "000002"],
        ["000000", "000010", "000020", "000030"],  # every tenth frame
        ["3", "7", "12", "80", "81"],  # chosen frames
        ["100", "200", "300", "400"],
        ["20240131", "20240201", "20240202"],
        ["1700000002.5", "1700000001.5", "1700000000.5"],  # not in the order of time
        ["5"],
        [],
    ],
)
def test_names_that_are_not(names: list[str]) -> None:
    assert name_stamps(names) is None


@pytest.mark.parametrize(
    "form",
    ["%Y-%m-%d_%H-%M-%S.%f", "%Y%m%d_%H%M%S_%f", "%Y-%m-%dT%H_%M_%S.%f", "%Y%m%d%H%M%S%f", "%Y-%m-%d %H.%M.%S.%f", "rgb_%Y%m%d-%H%M%S-%f"],
)
def test_dates_with_a_time_are_stamps_also_over_a_full_minute(form: str) -> None:
    moments = [datetime(2023, 5, 1, 12, 30, 59, 900000) + timedelta(milliseconds=40 * i) for i in range(6)]
    stems = [moment.strftime(form) for moment in moments]
    stamps = name_stamps(stems)
    assert stamps is not None
    np.testing.assert_allclose(stamps, 1682944259.9 + 0.04 * np.arange(6), rtol=0, atol=1e-5)
    assert [float(text or "nan") for text in counting_numbers(stems)] == stamps.tolist()


def test_whole_seconds_of_a_date_are_stamps() -> None:
    assert name_stamps(["20240131120000", "20240131120001", "20240131120002"]) == pytest.approx([1706702400, 1706702401, 1706702402])


def test_a_counter_behind_a_date_is_no_fraction_of_a_second() -> None:
    stems = [f"20230501_123059_{i:06d}" for i in range(5)]
    assert counting_numbers(stems) == [f"{i:06d}" for i in range(5)]
    assert name_stamps(stems) is None


def test_hexadecimal_names_count_as_one_number() -> None:
    assert counting_numbers(["01a2b8", "01a2bb", "01a2be"]) == [str(0x1A2B8), str(0x1A2BB), str(0x1A2BE)]
    assert counting_numbers(["a00009", "a00010"]) == ["00009", "00010"]  # a letter before a decimal number
