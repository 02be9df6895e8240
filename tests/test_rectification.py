"""Rectification of frames in motion: what a synchronised global shutter would have seen."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from idfslam.datasets.generated.faults import Faults
from idfslam.datasets.generated.handheld import HandheldRecording, handheld_room
from idfslam.geometry import se3
from idfslam.sensing.rectification import Rectification, RowTimes, along_camera, along_world, displacement, motions, rectified

Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def recording() -> HandheldRecording:
    return handheld_room(Faults.named("shutter=3+time"), seed=1, frames=120, width=160, height=120)


@pytest.fixture(scope="module")
def fastest(recording: HandheldRecording) -> int:
    return int(np.argmax([np.linalg.norm(recording.velocity(i)[3:]) for i in range(len(recording))]))


def times_of(recording: HandheldRecording, i: int) -> RowTimes:
    timing, frame = recording.true_timing, recording[i]
    return RowTimes(timing.readout or 0.0, timing.depth_readout or 0.0, frame.depth_lag + (timing.depth_delay or 0.0))


@pytest.mark.parametrize("turn", [0.0, 1e-9, 3.0])
def test_the_motion_of_a_row_is_the_exponential_of_its_time(turn: float) -> None:
    velocity, times = np.array([0.5, -0.2, 0.3, 0.6 * turn, -0.8 * turn, 0.0]), np.linspace(-0.02, 0.02, 5)
    exact = np.stack([se3.exp(torch.from_numpy(s * velocity)).numpy()[:3] for s in times])
    np.testing.assert_allclose(motions(velocity, times), exact, rtol=0, atol=2e-6)


def depth_error(depth: NDArray[np.float32], exact: NDArray[np.float32]) -> float:
    both = (depth > 0) & (exact > 0)
    assert both.mean() > 0.6
    return float(np.median(np.abs(depth - exact)[both]))


def test_a_fast_frame_becomes_what_a_global_shutter_sees(recording: HandheldRecording, fastest: int) -> None:
    frame, exact = recording[fastest], recording.exact(fastest)
    found = rectified(frame, Rectification(times_of(recording, fastest), recording.velocity(fastest)))
    assert displacement(frame, recording.velocity(fastest), 0.01) > 2  # [px] in a hundredth of a second
    raw, better = (float(np.median(np.abs(f.colour - exact.colour))) for f in (frame, found))
    assert better < 0.75 * raw  # the rest is grain
    assert depth_error(found.depth, exact.depth) < 0.65 * depth_error(frame.depth, exact.depth)
    assert found.depth_lag == 0


def test_the_wrong_velocity_makes_it_worse(recording: HandheldRecording, fastest: int) -> None:
    frame, exact, times = recording[fastest], recording.exact(fastest), times_of(recording, fastest)
    wrong = rectified(frame, Rectification(times, -recording.velocity(fastest)))
    assert np.median(np.abs(wrong.colour - exact.colour)) > np.median(np.abs(frame.colour - exact.colour))


def test_a_still_or_synchronised_frame_stays_as_it_is(recording: HandheldRecording) -> None:
    frame = recording[0]
    assert rectified(frame, Rectification(RowTimes(0.03, 0.03, 0.01), np.zeros(6))) is frame
    assert rectified(frame, Rectification(RowTimes(), np.ones(6))) is frame


def test_colour_stays_in_steps_of_a_byte(recording: HandheldRecording, fastest: int) -> None:
    found = rectified(recording[fastest], Rectification(RowTimes(0.03), recording.velocity(fastest)))
    steps = np.rint(found.colour * 255).astype(np.uint8)
    assert np.array_equal(steps * np.float32(1 / 255), found.colour)


def test_a_hole_stays_a_hole(recording: HandheldRecording, fastest: int) -> None:
    frame = recording[fastest]
    frame.depth[40:80, 60:100] = 0
    found = rectified(frame, Rectification(RowTimes(0.0, 0.0, 0.001), recording.velocity(fastest)))
    assert (found.depth[55:65, 75:85] == 0).all()


def test_velocities_along_the_cameras_axes_and_back() -> None:
    T_wc = torch.eye(4, dtype=torch.float64)
    T_wc[:3, :3] = torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])  # a quarter turn about z
    velocity = np.array([1.0, 2, 3, 4, 5, 6])
    assert along_camera(T_wc, velocity).tolist() == [2, -1, 3, 5, -4, 6]
    assert along_world(T_wc, along_camera(T_wc, velocity)).tolist() == velocity.tolist()


def test_the_longest_time_of_a_frame() -> None:
    assert RowTimes(0.03, 0.02, -0.012).longest == pytest.approx(0.022)
    assert RowTimes(0.03).longest == pytest.approx(0.015)
    assert RowTimes().synchronised
    assert not RowTimes(depth_delay=0.001).synchronised


CHECKSUM = """
import zlib
import numpy as np
from idfslam.sensing.rectification import Rectification, RowTimes, rectified
from idfslam.slam.warm_up import made_up
found = rectified(made_up(0), Rectification(RowTimes(0.03, 0.03, -0.01), np.linspace(-1, 1, 6)))
print(zlib.crc32(found.colour), zlib.crc32(found.depth))
"""


@pytest.mark.slow
def test_a_process_that_compiles_and_one_that_does_not_see_the_same(tmp_path: Path) -> None:
    """With fast mathematics colour differed by a step of a byte here and there, and a run of the first kind could not be resumed."""
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    first, second = (
        subprocess.run([sys.executable, "-c", CHECKSUM], check=True, capture_output=True, text=True, env=environment).stdout
        for _ in range(2)
    )
    assert first == second
