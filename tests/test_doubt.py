"""The two rates of doubt, on trajectories whose wrong frames are put in by hand: the truth moves 1 cm a frame along x."""

from collections.abc import Collection, Mapping

import numpy as np
import pytest

from idfslam.evaluation.doubt import DoubtRates, ReportedFrames, confidence, doubt_rates, off_frames
from idfslam.frame import FrameResult, Status

FRAMES = 100


def truth() -> np.ndarray:
    poses = np.tile(np.eye(4), (FRAMES, 1, 1))
    poses[:, 0, 3] = 0.01 * np.arange(FRAMES)
    return poses


def reported(shifts: Mapping[int, float], statuses: Mapping[int, Status] | None = None, corrected: Collection[int] = ()) -> ReportedFrames:
    """The truth in another world, with shifts [m] of some frames along y."""
    poses, other = truth(), np.eye(4)
    for i, shift in shifts.items():
        poses[i, 1, 3] = shift
    other[:3, :3], other[:3, 3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]], [3, 2, 1]
    told = [(statuses or {}).get(i, Status.OK) for i in range(FRAMES)]
    return ReportedFrames(
        np.arange(FRAMES) / 30, other @ poses, told, np.arange(FRAMES) % 10 == 0, np.full((FRAMES, 6, 6), np.nan), corrected
    )


def off(run: ReportedFrames) -> list[int]:
    return np.flatnonzero(off_frames(run, truth())[0]).tolist()


def test_a_right_trajectory_has_no_frame_that_is_off() -> None:
    rates = doubt_rates(reported({}), truth())
    assert rates == DoubtRates(good=99)  # the first frame is the first reference
    assert (rates.missed_rate, rates.false_alarm_rate) == (None, 0.0)


def test_a_jump_that_is_taken_back() -> None:
    """Frames 40 to 42 are off by 6 cm, frame 41 is called doubtful; frame 60 is good, and called lost."""
    run = reported({40: 0.06, 41: 0.06, 42: 0.06, 70: 0.04}, {41: Status.DOUBTFUL, 60: Status.LOST, 61: Status.DEGENERATE})
    assert off(run) == [40, 41, 42]
    rates = doubt_rates(run, truth())
    assert rates == DoubtRates(off=3, missed=2, good=96, false_alarms=1, passages=1, passages_missed=0)
    assert rates.missed_rate == pytest.approx(2 / 3) and rates.false_alarm_rate == pytest.approx(1 / 96)


def test_a_turn_of_more_than_two_degrees() -> None:
    run = reported({})
    for i, degrees in ((30, 1.9), (50, 2.1)):
        c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
        run.T_wc[i, :3, :3] = run.T_wc[i, :3, :3] @ [[c, 0, s], [0, 1, 0], [-s, 0, c]]
    assert off(run) == [50]
    assert doubt_rates(run, truth()) == DoubtRates(off=1, missed=1, good=98, passages=1, passages_missed=1)


def test_slow_drift_is_never_off() -> None:
    assert off(reported({i: 0.01 * i for i in range(FRAMES)})) == []  # 99 cm at the end


def test_a_jump_that_nobody_noticed_counts_for_a_second() -> None:
    assert off(reported({i: 0.5 for i in range(20, FRAMES)})) == list(range(20, 50))


def test_a_jump_that_is_called_bad_is_measured_from_the_frame_before_it() -> None:
    doubtful = {i: Status.DOUBTFUL for i in range(20, 80)}
    run = reported({i: 0.5 for i in range(20, 80)}, doubtful)
    assert off(run) == list(range(20, 80))  # also after 30 frames
    assert doubt_rates(run, truth()) == DoubtRates(off=60, good=39, passages=1)


def test_a_lost_camera_that_creeps_away_is_off() -> None:
    """The made-up poses leave the truth by 1 cm a frame: none is the reference of the next."""
    lost = {i: Status.LOST for i in range(20, 40)}
    run = reported({i: 0.01 * (i - 19) for i in range(20, 40)}, lost)
    assert off(run) == list(range(25, 40))
    assert doubt_rates(run, truth()) == DoubtRates(off=15, good=84, false_alarms=5, passages=1)


def test_a_closed_loop_is_no_motion() -> None:
    shifts = {i: 0.5 for i in range(20, FRAMES)}
    found, judged = off_frames(reported(shifts, corrected=(20,)), truth())
    assert not found.any() and np.flatnonzero(~judged).tolist() == [0, 20]


def test_frames_without_truth_are_not_judged() -> None:
    known = truth()
    known[[0, 30, 31]] = np.nan
    found, judged = off_frames(reported({30: 1.0, 50: 0.06}, {1: Status.LOST}), known)
    assert np.flatnonzero(~judged).tolist() == [0, 1, 2, 30, 31]  # frame 2 is the first reference
    assert np.flatnonzero(found).tolist() == [50]


def test_passages_end_where_a_good_frame_lies_between() -> None:
    run = reported({40: 0.06, 41: 0.06, 43: 0.06, 99: 0.2}, {43: Status.DOUBTFUL})
    assert doubt_rates(run, truth()) == DoubtRates(off=4, missed=3, good=95, passages=3, passages_missed=2)


def test_rates_of_several_runs_and_their_confidence() -> None:
    rates = DoubtRates(off=40, missed=1, good=500, passages=3) + DoubtRates(off=60, missed=1, good=460, false_alarms=6, passages=2)
    assert rates == DoubtRates(off=100, missed=2, good=960, false_alarms=6, passages=5)
    written = rates.to_dict()
    assert (written["missed_rate"], written["false_alarm_rate"]) == (0.02, 0.00625)
    assert written["missed_rate_95"] == pytest.approx([0.0055, 0.0700], abs=1e-4)  # Wilson's interval of 2 in 100
    assert confidence(0, 0) is None and confidence(0, 100) == pytest.approx([0, 0.0370], abs=1e-4)
    assert DoubtRates().to_dict()["missed_rate"] is None


def test_reports_of_frames() -> None:
    covariance = np.diag([1.0, 2, 3, 4, 5, 6])
    results = [FrameResult(i, i / 30, np.eye(4), Status.OK, i == 0, {}, covariance if i else None) for i in range(3)]
    run = ReportedFrames.of(results, corrected=(2,))
    assert run.keyframes.tolist() == [True, False, False] and np.isnan(run.covariances[0]).all()
    assert np.array_equal(run.covariances[2], covariance) and run.corrected == (2,)
    assert ReportedFrames.of([]).T_wc.shape == (0, 4, 4)
