"""Motion compensation in whole runs: a rolling shutter's times are found, poses are no worse for it, and resumed runs are the same."""

from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest

from idfslam.config import FAST
from idfslam.datasets.generated.faults import Faults
from idfslam.datasets.generated.handheld import HandheldRecording, handheld_room
from idfslam.datasets.recording import Selection
from idfslam.geometry.sensor_timing import SYNCHRONISED
from idfslam.geometry.trajectory import align
from idfslam.slam import Slam

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
