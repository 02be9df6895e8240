"""Doubt: does a system know which of its poses are wrong?

A frame is *off* if the motion since the last good frame, as the poses told it at the time, differs from the true motion by more than
`OFF_SHIFT` or `OFF_TURN`; otherwise it is *good*. The last good frame is the last one that was good and called good. So slow drift is never
off, and a run of off frames, or of frames that the system does not trust, is measured from the frame before it. The pose after a jump that
nobody noticed is the new reference once `_SETTLED` frames in a row were off and called good: one jump counts that often, not to the end.

A frame is called bad if its status is doubtful, lost or interpolated, and else it is called good. Two shares describe the doubt, as the two
kinds of error of a detector: `missed` of the off frames are called good, `false_alarms` of the good ones are called bad.
"""

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from idfslam.evaluation.trajectory_error import errors_of_motion, has_truth
from idfslam.frame import FrameResult, Status

Poses = NDArray[np.float64]

OFF_SHIFT = 0.05  # [m] largest error of the motion since the last good frame that is not off. More: fewer frames are off. Chosen by hand
OFF_TURN = 2.0  # [degrees] the same of the turn. More: fewer frames are off. Chosen by hand
# [frames] in a row that are off and called good, after which the system is judged from where it believes to be. More: a jump that nobody
# noticed counts more often. One second. Chosen by hand
_SETTLED = 30
_NORMAL_95 = 1.959963984540054  # [1] standard deviations within which 95 % of a normal distribution lie: a fact, not a choice


@dataclass(frozen=True, eq=False)
class ReportedFrames:
    """What a system reported of each frame when the frame was processed, before later frames and loops improved it."""

    timestamps: NDArray[np.float64]  # (N,) [s]
    T_wc: Poses  # (N, 4, 4)
    statuses: Sequence[Status]
    keyframes: NDArray[np.bool_]  # (N,)
    covariances: NDArray[np.float64]  # (N, 6, 6) as in `Tracked.covariance`; NaN where there is none
    corrected: Collection[int] = ()  # frames at which a closed loop moved the camera: a jump that is no motion

    @staticmethod
    def of(results: Sequence[FrameResult], corrected: Collection[int] = ()) -> "ReportedFrames":
        """The results of `Slam.process` in their order."""
        unknown = np.full((6, 6), np.nan)
        return ReportedFrames(
            np.array([result.timestamp for result in results], np.float64),
            np.array([result.T_wc for result in results]).reshape(-1, 4, 4),
            [result.status for result in results],
            np.array([result.keyframe for result in results], bool),
            np.array([unknown if result.covariance is None else result.covariance for result in results]).reshape(-1, 6, 6),
            corrected,
        )


@dataclass(frozen=True)
class DoubtRates:
    """Counts of judged frames, by what they are and what they were called. Counts of several runs can be added."""

    off: int = 0
    missed: int = 0  # off, and called good
    good: int = 0
    false_alarms: int = 0  # good, and called bad
    passages: int = 0  # runs of off frames
    passages_missed: int = 0  # those of which no frame was called bad

    def __add__(self, other: "DoubtRates") -> "DoubtRates":
        return DoubtRates(**{name: count + getattr(other, name) for name, count in vars(self).items()})

    @property
    def missed_rate(self) -> float | None:
        """The share of off frames that are called good; None if no frame is off."""
        return self.missed / self.off if self.off else None

    @property
    def false_alarm_rate(self) -> float | None:
        """The share of good frames that are called bad; None if no frame is good."""
        return self.false_alarms / self.good if self.good else None

    def to_dict(self) -> dict[str, Any]:
        """Counts, shares (0 to 1) and their confidence intervals of 95 %, as values that JSON has."""
        return {
            "off": self.off,
            "missed": self.missed,
            "missed_rate": self.missed_rate,
            "missed_rate_95": confidence(self.missed, self.off),
            "good": self.good,
            "false_alarms": self.false_alarms,
            "false_alarm_rate": self.false_alarm_rate,
            "false_alarm_rate_95": confidence(self.false_alarms, self.good),
            "passages": self.passages,
            "passages_missed": self.passages_missed,
        }


def confidence(found: int, of: int) -> list[float] | None:
    """Wilson's confidence interval of 95 % of a share; None if it is a share of none.

    It takes frames as independent. Neighbours are not, so the true interval is wider.
    """
    if not of:
        return None
    share, added = found / of, _NORMAL_95**2 / of
    half_width = _NORMAL_95 * math.sqrt((share * (1 - share) + added / 4) / of)
    low, high = ((share + added / 2 + sign * half_width) / (1 + added) for sign in (-1, 1))
    return [low if found else 0.0, high if found < of else 1.0]


def off_frames(reported: ReportedFrames, truth: Poses) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which frames are off (N,), and which are judged at all (N,).

    Not judged are frames without truth, frames before the first one that is called good, and those at which a loop moved the camera.
    truth: (N, 4, 4) camera-to-world, NaN where a frame has none. Raises `TrajectoryError` if the shapes differ.
    """
    known, trusted = has_truth(reported.T_wc, truth), [status.trusted for status in reported.statuses]
    off, judged = np.zeros(len(truth), bool), np.zeros(len(truth), bool)
    reference, unnoticed = None, 0  # the last good frame; and the number of frames in a row that are off and called good
    for i in np.flatnonzero(known):
        if reference is None or i in reported.corrected:
            reference, unnoticed = (i, 0) if trusted[i] else (reference, unnoticed)
            continue
        shift, turn = errors_of_motion(reported.T_wc[[reference]], reported.T_wc[[i]], truth[[reference]], truth[[i]])
        judged[i], off[i] = True, shift[0] > OFF_SHIFT or turn[0] > OFF_TURN
        unnoticed = unnoticed + 1 if off[i] and trusted[i] else 0
        if trusted[i] and (not off[i] or unnoticed == _SETTLED):
            reference, unnoticed = i, 0
    return off, judged


def doubt_rates(reported: ReportedFrames, truth: Poses) -> DoubtRates:
    """The counts of one run against the truth (N, 4, 4), NaN where a frame has none. Raises `TrajectoryError` if the shapes differ."""
    off, judged = off_frames(reported, truth)
    bad = ~np.array([status.trusted for status in reported.statuses], bool)
    passages = _runs(np.flatnonzero(judged), off)
    return DoubtRates(
        off=int(off.sum()),
        missed=int((off & ~bad).sum()),
        good=int((judged & ~off).sum()),
        false_alarms=int((judged & ~off & bad).sum()),
        passages=len(passages),
        passages_missed=sum(not bad[passage].any() for passage in passages),
    )


def _runs(frames: NDArray[np.int64], off: NDArray[np.bool_]) -> list[NDArray[np.int64]]:
    """The runs of neighbours among `frames` that are off."""
    ends = np.flatnonzero(np.diff(off[frames].astype(np.int8))) + 1
    return [run for run in np.split(frames, ends) if len(run) and off[run[0]]]
