"""The usual interval of frames, by hand: jitter is taken out, gaps are kept, and stamps that do not grow tell nothing."""

import pytest

from idfslam.alignment.frame_interval import FrameInterval


def after(intervals: list[float]) -> FrameInterval:
    interval = FrameInterval()
    for seconds in intervals:
        interval.add(seconds)
    return interval


def test_before_the_second_frame_it_is_a_thirtieth() -> None:
    assert FrameInterval().in_whole_frames(0.05) == pytest.approx(2 / 30)


def test_jitter_is_taken_out_and_a_gap_is_kept() -> None:
    interval = after([0.10, 0.11, 0.09, 0.10, 0.5])
    assert interval.in_whole_frames(0.12) == pytest.approx(0.1)
    assert interval.in_whole_frames(0.29) == pytest.approx(0.3)
    assert interval.in_whole_frames(0.0) == pytest.approx(0.1)


def test_stamps_that_do_not_grow_tell_nothing() -> None:
    assert after([0.1, 0.0, -2.0, -2.0]).in_whole_frames(0.2) == pytest.approx(0.2)


def test_a_restored_one_goes_on() -> None:
    one = after([0.1, 0.2, 0.2])
    assert FrameInterval(one.recent()).in_whole_frames(0.5) == one.in_whole_frames(0.5) == pytest.approx(0.4)
