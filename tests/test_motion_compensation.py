"""Motion compensation in whole runs: a rolling shutter's times are found, poses are no worse for it, and resumed runs are the same."""

from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest
import torch

from idfslam.config import FAST
from idfslam.datasets.generated.faults import Faults
from idfslam.datasets.generated.handheld import HandheldRecording, handheld_room
from idfslam.datasets.recording import Selection
from idfslam.geometry.sensor_timing import SYNCHRONISED
from idfslam.geometry.trajectory import align
from idfslam.graph.keyframe import Keyframe
from idfslam.slam import Slam
from idfslam.slam.front_end.alignment_to_map import AlignmentToMap

FAST_PART = 60  # frame at which the camera of seed 1 begins to shake
CONFIG = replace(FAST, refine=False, finetune=replace(FAST.finetune, enabled=False))


@pytest.fixture(scope="module")
def shaken() -> HandheldRecording:
    return handheld_room(Faults.named("shutter=1.5+time"), seed=1, frames=150, width=160, height=120)


def ate(slam: Slam, truth: np.ndarray) -> float:
    """[m]"""
    positions = slam.trajectory()[:, :3, 3]
    T = align(positions, truth[:, :3, 3])
    return float(np.sqrt(((positions @ T[:3, :3].T + T[:3, 3] - truth[:, :3, 3]) ** 2).sum(1).mean()))


@pytest.mark.slow
def test_times_are_estimated_and_poses_are_no_worse_for_it(shaken: HandheldRecording) -> None:
    aware, unaware = Slam(CONFIG), Slam(CONFIG)
    for i in range(len(shaken)):
        frame = shaken[i]
        aware.process(frame)
        unaware.process(replace(frame, timing=SYNCHRONISED, depth_timestamp=None))
    found, true = aware.figures()["sensor_timing"], shaken.true_timing
    assert unaware.figures()["sensor_timing"] is None
    for name in ("readout", "depth_readout"):  # few and coarse frames: the estimates are still on their way from zero
        assert 0.4 * getattr(true, name) < found[name] < 1.2 * getattr(true, name)
    assert ate(aware, shaken.ground_truth) < 1.05 * ate(unaware, shaken.ground_truth)  # so small images gain little (docs/results.md)


@pytest.mark.slow
def test_a_resumed_run_is_the_same_to_the_bit(shaken: HandheldRecording) -> None:
    frames = Selection(shaken, start=FAST_PART, frames=30)
    unbroken, again = Slam(CONFIG), Slam(CONFIG)
    for i in range(20):
        unbroken.process(frames[i])
    again.restore(deepcopy(unbroken.state()), lambda index: frames[index])
    assert unbroken.graph.keyframes[0].rectification is not None or unbroken.figures()["sensor_timing"] is None
    for i in range(20, 30):
        one, other = unbroken.process(frames[i]), again.process(frames[i])
        assert np.array_equal(one.T_wc, other.T_wc) and one.status is other.status


@pytest.mark.parametrize(("speed", "sigma", "again"), [(2.0, 0.002, True), (0.1, 0.002, False), (2.0, 0.004, False)])
def test_keyframes_are_rectified_again_where_a_time_has_changed_by_much(
    shaken: HandheldRecording, speed: float, sigma: float, again: bool
) -> None:
    """By 8 ms at first, by 12 and by 14 ms later.

    speed [rad/s]: at 2, 6 ms are 2 px of 160; a slow keyframe stays as it is. sigma [s] of the estimate: 6 ms are less than two of 4 ms.
    """
    front_end, frame = Slam(CONFIG).front_end, shaken[0]
    assert isinstance(front_end, AlignmentToMap)
    calibration, keyframes = front_end.compensation.calibration, front_end.compensation.keyframes
    keyframe = Keyframe(frame, torch.eye(4, dtype=torch.float64), torch.from_numpy(frame.depth), torch.from_numpy(frame.colour))
    keyframe.velocity = np.array([0, 0, 0, 0, speed, 0])
    told = []
    for delay in (-0.008, -0.012, -0.014):
        calibration.estimator.timing = lambda stated, delay=delay: (0.0, 0.0, delay)  # type: ignore[method-assign]
        calibration.estimates = lambda delay=delay: {"depth_delay": (delay, sigma)}  # type: ignore[method-assign]
        calibration.stated = frame.timing
        told.append(keyframes.is_due(keyframe.index))
        if told[-1]:
            assert keyframes.rectify(keyframe) is (again or delay == -0.008)
    assert told == [True, False, sigma < 0.003]
    assert keyframe.rectification is not None
    assert keyframe.rectification.times.depth_delay == pytest.approx(frame.depth_lag - (0.014 if again else 0.008))
    assert len(keyframe.earlier_times) == again


def test_a_synchronised_recording_passes_unchanged() -> None:
    ideal = handheld_room(Faults.named("ideal"), seed=1, frames=4, width=160, height=120)
    slam = Slam(CONFIG)
    for i in range(4):
        slam.process(ideal[i])
    assert slam.graph.keyframes[0].rectification is None
    assert slam.figures()["sensor_timing"] is None


def test_frames_without_depth_are_tracked_and_never_mapped() -> None:
    ideal = handheld_room(Faults.named("ideal"), seed=1, frames=12, width=160, height=120)
    slam = Slam(replace(CONFIG, refine=True, mapper=replace(CONFIG.mapper, every=1)))
    mapped: list[bool] = []
    add = slam.coverage.add
    slam.coverage.add = lambda view: (mapped.append(view.has_depth), add(view))[1]  # type: ignore[method-assign,assignment]
    for i in range(12):
        frame = ideal[i]
        result = slam.process(frame if i < 8 else replace(frame, depth=np.zeros_like(frame.depth)))
        assert result.status.value == ("ok" if i < 8 else "degenerate")
    slam.finish()
    assert all(mapped) and len(mapped) >= 8
    assert ate(slam, ideal.ground_truth) < 0.005
