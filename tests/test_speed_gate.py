"""A hand does not leap: poses out of its reach are told, and photographs, gaps in the stamps and lost cameras are not taken for leaps."""

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from idfslam.frame import Status
from idfslam.geometry import se3
from idfslam.slam.front_end.speed_gate import SpeedGate
from idfslam.slam.tracked import Source, Tracked


class Poses:
    """The poses of frames, as `FramePoses` tells them."""

    def __init__(self) -> None:
        self.poses: list[Tensor] = []

    def T_wc(self, index: int) -> Tensor:
        return self.poses[index]


def at(x: float, degrees: float = 0.0) -> Tensor:
    return se3.exp(torch.tensor([x, 0, 0, 0, math.radians(degrees), 0], dtype=torch.float64))


def tracked(T_wc: Tensor, status: Status = Status.OK, source: Source = Source.ALIGNED) -> Tracked:
    return Tracked(T_wc, status, source)


def carried(frames: int, step: float = 0.03, interval: float = 1 / 30) -> tuple[SpeedGate, Poses]:
    """After so many frames, each so far from the one before [m]."""
    poses = Poses()
    gate = SpeedGate(poses)  # type: ignore[arg-type]
    for i in range(frames):
        poses.poses.append(at(i * step))
        gate.accept(i, i * interval, tracked(poses.poses[-1]))
    return gate, poses


@pytest.mark.parametrize(
    ("metres", "degrees", "leap"),
    [(0.06, 11, False), (0.34, 0, True), (0.08, 0, True), (0.07, 0, False), (-0.07, 0, True), (0.01, 12, True)],
)
def test_a_step_of_a_frame(metres: float, degrees: float, leap: bool) -> None:
    """2 m/s are 6.7 cm a frame, and 6 rad/s 11.5 degrees. The camera goes on by 1 cm a frame."""
    gate, poses = carried(20, step=0.01)
    assert gate.is_leap(20 / 30, poses.poses[-1] @ at(metres, degrees)) == leap


def test_a_leap_is_told_until_a_hand_could_be_there() -> None:
    gate, poses = carried(20, step=0.0)
    there = poses.poses[-1] @ at(0.34)
    for i in range(20, 30):
        told = gate.is_leap(i / 30, there)
        assert told == (i < 25), i
        poses.poses.append(there)
        gate.accept(i, i / 30, tracked(there, Status.DOUBTFUL if told else Status.OK))


def test_a_gap_in_the_stamps_gives_time() -> None:
    gate, poses = carried(20)
    assert not gate.is_leap(19 / 30 + 0.2, poses.poses[-1] @ at(0.34))
    assert gate.is_leap(19 / 30 + 0.001, poses.poses[-1] @ at(0.34))  # a stamp that is late by a frame is one frame later
    assert not gate.is_leap(19 / 30 + 0.001, poses.poses[-1] @ at(0.05))


def test_photographs_do_not_leap() -> None:
    """They are stamped as a video's, 15 cm apart."""
    gate, poses = carried(20, step=0.15)
    assert not gate.is_leap(20 / 30, poses.poses[-1] @ at(0.3))


def test_a_vehicle_that_becomes_fast_does_not_leap() -> None:
    """It gains 0.3 m/s in each frame, up to 5 m/s."""
    gate, poses = carried(20, step=0.01)
    for i in range(20, 37):
        poses.poses.append(poses.poses[-1] @ at(0.01 * (i - 19)))
        assert not gate.is_leap(i / 30, poses.poses[-1])
        gate.accept(i, i / 30, tracked(poses.poses[-1]))


def test_it_takes_ten_frames_to_know_a_hand() -> None:
    assert [carried(frames)[0].is_leap(frames / 30, at(9.0)) for frames in (1, 9, 10)] == [False, False, True]


@pytest.mark.parametrize("result", [tracked(at(0), Status.LOST), tracked(at(5), source=Source.RELOCALISED)])
def test_a_lost_camera_may_be_anywhere(result: Tracked) -> None:
    gate, poses = carried(20)
    poses.poses.append(result.T_wc)
    gate.accept(20, 20 / 30, replace(result))
    assert not gate.is_leap(21 / 30, at(5.0))


def test_the_state_is_all_that_it_knows() -> None:
    gate, poses = carried(20)
    restored = SpeedGate(poses)  # type: ignore[arg-type]
    restored.restore(gate.state())
    there = poses.poses[-1] @ at(0.34)
    assert restored.is_leap(20 / 30, there) and restored.state() == gate.state()
    fresh = SpeedGate(poses)  # type: ignore[arg-type]
    restored.restore(fresh.state())
    assert not restored.is_leap(20 / 30, there)
