"""The motion of a camera within a frame: points at the times of their rows."""

import numpy as np
import pytest
import torch
from scipy.linalg import expm

from idfslam.alignment.frame_motion import FrameMotion, carried, plain_carried
from idfslam.sensing.rectification import RowTimes

VELOCITY = np.array([0.4, -0.3, 0.2, 1.0, 2.0, -1.5])  # a hand that shakes: 2.7 rad/s


@pytest.fixture
def points() -> torch.Tensor:
    return torch.randn(200, 3, generator=torch.Generator().manual_seed(0)) * 2


def test_points_are_carried_along_the_exponential(points: torch.Tensor) -> None:
    seconds = torch.linspace(-0.015, 0.015, 200)
    v, (a, b, c) = VELOCITY[:3], VELOCITY[3:]
    twist = np.block([[np.array([[0, -c, b], [c, 0, -a], [-b, a, 0]]), v[:, None]], [np.zeros((1, 4))]])
    for i in range(0, 200, 20):
        exact = (expm(float(seconds[i]) * twist) @ np.append(points[i].numpy(), 1))[:3]
        np.testing.assert_allclose(carried(points, seconds, VELOCITY)[i].numpy(), exact, atol=1e-4)  # [m]


def test_the_compiled_form_is_the_plain_one(points: torch.Tensor) -> None:
    seconds = torch.linspace(-0.03, 0.03, 200)
    torch.testing.assert_close(carried(points, seconds, VELOCITY), plain_carried(points, seconds, VELOCITY), rtol=0, atol=1e-5)


def test_depth_goes_to_the_stamp_and_back_to_its_rows(points: torch.Tensor) -> None:
    motion, rows = FrameMotion(RowTimes(0.03, 0.02, 0.01), VELOCITY), torch.linspace(-0.5, 0.5, 200)
    there = motion.depth_at_stamp(points, rows)
    assert float((there - points).norm(dim=-1).max()) > 0.05
    torch.testing.assert_close(motion.depth_at_rows(there, rows), points, rtol=0, atol=1e-3)
    assert torch.equal(motion.colour_at_rows(points, torch.zeros(200)), points)  # the middle row is that of the time stamp
