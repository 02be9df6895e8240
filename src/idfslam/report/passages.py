"""Passages of frames whose pose is not trusted, in plain words."""

import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from idfslam.frame import Status
from idfslam.runs.frame_log import FrameLine, FrameLog

_MOST = 12  # passages that are told one by one, the longest ones; more: a longer list. Chosen by hand
# [degrees/s] median turn of a passage from which it is told that the camera turned quickly. More: it is told of wilder motion only. At 30
# frames/s a turn of 2 degrees a frame. Chosen by hand
_QUICK_TURN = 60.0


def passages(log: FrameLog, poses: NDArray[np.float64]) -> list[str]:
    """A sentence for each run of frames with one status that is not trusted, in their order; the shorter ones of many are counted.

    poses: (N, 4, 4) the trajectory of all frames.
    """
    runs = [list(lines) for status, lines in itertools.groupby(log.lines, lambda line: line.status) if not status.trusted]
    longest = sorted(sorted(runs, key=len, reverse=True)[:_MOST], key=lambda lines: lines[0].index)
    told = [f"{_place(lines)}: {_sentence(lines, poses)}." for lines in longest]
    if len(runs) > _MOST:
        rest = sum(map(len, runs)) - sum(map(len, longest))
        told.append(f"{len(runs) - _MOST} shorter passages of {rest} frames in all; frames.csv has the status of each frame.")
    return told


def _place(lines: Sequence[FrameLine]) -> str:
    first, last = lines[0], lines[-1]
    if first is last:
        return f"Frame {first.index}"
    return f"Frames {first.index} to {last.index} ({last.timestamp - first.timestamp:.1f} s)"


def _sentence(lines: Sequence[FrameLine], poses: NDArray[np.float64]) -> str:
    pose, was = ("the pose", "was") if len(lines) == 1 else ("the poses", "were")
    fate = "" if any(line.keyframe for line in lines) else f"; {'it' if len(lines) == 1 else 'they'} {was} not mapped"
    if lines[0].status is Status.DOUBTFUL:
        return f"the images did not agree with the map{_motion(lines, poses)}; {pose} may be off{_expected(lines)}{fate}"
    if lines[0].status is Status.INTERPOLATED:
        return f"the camera was lost and found again; {pose} {was} put between the known ones before and after{fate}"
    if lines[0].index == 0:
        return f"no image gave a pose yet; {pose} {'is that' if len(lines) == 1 else 'are those'} of the start{fate}"
    return f"no image confirmed a pose; the last motion was carried on, so {pose} may be far off{fate}"


def _expected(lines: Sequence[FrameLine]) -> str:
    """By how much the poses may be off, if that is known: the largest expected errors."""
    sigmas = [(line.sigma_position, line.sigma_rotation) for line in lines]
    known = [(position, rotation) for position, rotation in sigmas if position is not None and rotation is not None]
    if not known:
        return ""
    position, rotation = (max(values) for values in zip(*known))
    return f" by about {_rounded(position * 100)} cm and {_rounded(rotation)} degrees"


def _motion(lines: Sequence[FrameLine], poses: NDArray[np.float64]) -> str:
    """That the camera turned quickly, if it did."""
    first, last = max(lines[0].index - 1, 0), lines[-1].index
    seconds, steps = lines[-1].timestamp - lines[0].timestamp, len(lines) - 1
    if last >= len(poses) or last <= first or steps < 1 or seconds <= 0:
        return ""
    R = poses[first : last + 1, :3, :3]
    turns = np.rad2deg(Rotation.from_matrix(R[:-1].transpose(0, 2, 1) @ R[1:]).magnitude())
    speed = float(np.median(turns)) * steps / seconds
    return f" while the camera turned quickly (about {_rounded(speed)} degrees/s)" if speed >= _QUICK_TURN else ""


def _rounded(value: float) -> str:
    """Two digits."""
    return f"{float(f'{value:.2g}'):g}"
