"""The motion model: what it predicts, what it believes, and what it carries through a passage without information."""

import numpy as np
import pytest
import torch
from torch import Tensor

from idfslam.alignment.motion import Information, MotionModel, change_between, moved, plain_change_between, plain_moved
from idfslam.alignment.row_moments import RowMoments
from idfslam.geometry import se3

EYE = torch.eye(4, dtype=torch.float64)
WALK = se3.exp(torch.tensor([0.01, 0.0, 0.02, 0.0, 0.01, 0.0], dtype=torch.float64))


def of_diagonal(*values: float, weight: float = 100.0, radius: float = 2.0) -> Information:
    return Information.of(weight * torch.diag(torch.tensor(values, dtype=torch.float64)), weight, radius)


def test_a_turn_counts_as_the_shift_of_a_point_at_the_scenes_distance() -> None:
    # 4 of a turn at 2 m is 4 / 2^2 = 1 of a shift
    torch.testing.assert_close(of_diagonal(1, 1, 1, 4, 4, 4).values, torch.ones(6, dtype=torch.float64))


@pytest.mark.parametrize(("value", "share"), [(0.008, 0.5), (0.08, 1 - 1e-4), (0.0008, 1e-4)])
def test_a_direction_is_measured_by_a_share_that_its_information_decides(value: float, share: float) -> None:
    information = of_diagonal(value, 1, 1, 4, 4, 4)
    H = 100 * torch.diag(torch.tensor([value, 1, 1, 4, 4, 4], dtype=torch.float64))
    b = H @ torch.tensor([0.01, 0, 0, 0, 0, 0], dtype=torch.float64)  # a measurement 1 cm along x of the guess
    found = torch.linalg.solve(H + information.prior(0.008), b)
    assert float(found[0]) == pytest.approx(0.01 * share, rel=1e-3)
    change = torch.tensor([0.01, 0.02, 0, 0, 0.03, 0], dtype=torch.float64)
    expected = change * torch.tensor([share, 1, 1, 1, 1, 1])
    torch.testing.assert_close(information.trusted(change, 0.008), expected, rtol=1e-3, atol=1e-9)


@pytest.mark.parametrize(("value", "left"), [(0.001, 0.0), (0.002, 0.0), (0.004, 0.002), (0.04, 0.038)])
def test_what_noise_alone_would_tell_is_taken_out(value: float, left: float) -> None:
    """By a share of each direction: what it measures stays where it is, and counts less."""
    H, change = np.array([100, 10, 2])[:, None, None] * np.diag([value, 1, 1, 4, 4, 4]), np.array([0.01, 0.02, 0, 0, 0.03, 0])
    sums = RowMoments(H, H[:2] @ change)
    reliable = Information.of(torch.from_numpy(H[0]), 100.0, 2.0).reliable(sums, 0.002)
    kept = np.array([left, 0.998, 0.998, 3.992, 3.992, 3.992])
    np.testing.assert_allclose(reliable.H, np.array([100, 10, 2])[:, None, None] * np.diag(kept), atol=1e-9)
    np.testing.assert_allclose(reliable.b, np.array([100, 10])[:, None] * kept * change, atol=1e-9)


def test_no_information_at_all_holds_and_stays_finite() -> None:
    nothing = Information.of(torch.zeros(6, 6, dtype=torch.float64), 0.0, 0.0)
    assert nothing.prior(0.008).isfinite().all()
    assert torch.linalg.eigvalsh(nothing.prior(0.008))[0] > 0
    assert not nothing.trusted(torch.ones(6, dtype=torch.float64), 0.008).any()


def test_change_and_move_are_inverse() -> None:
    T, other = WALK, se3.exp(torch.tensor([0.3, -0.2, 0.1, 0.5, -0.4, 0.3], dtype=torch.float64))
    torch.testing.assert_close(moved(T, change_between(T, other)), other)


@pytest.mark.parametrize("turn", [0.0, 1e-12, 1e-7, 1e-3, 0.5, 2.0, 3.1])
def test_the_compiled_changes_are_the_plain_ones(turn: float) -> None:
    change = torch.tensor([0.3, -0.2, 0.1, 0.6 * turn, -0.8 * turn, 0.0], dtype=torch.float64)
    other = plain_moved(WALK, change)
    torch.testing.assert_close(moved(WALK, change), other, rtol=0, atol=1e-14)
    torch.testing.assert_close(change_between(WALK, other), plain_change_between(WALK, other), rtol=0, atol=1e-14)
    torch.testing.assert_close(change_between(WALK, other), change, rtol=0, atol=1e-12)


def drive(model: MotionModel, T: Tensor, steps: int, information: Information | None = None) -> Tensor:
    """Frames that are all found where `WALK` puts them."""
    for _ in range(steps):
        model.update(T, T @ WALK, information, 0.008)
        T = T @ WALK
    return T


def test_a_steady_walk_is_predicted() -> None:
    model = MotionModel()
    T = drive(model, EYE, 3)
    torch.testing.assert_close(model.predict(T), T @ WALK)
    model.stop()
    torch.testing.assert_close(model.predict(T), T)


def test_an_open_direction_keeps_the_velocity_and_forgets_the_turn() -> None:
    model = MotionModel()
    T = drive(model, EYE, 3)
    wall = of_diagonal(1e-5, 1e-5, 10, 40, 40, 4e-5)  # along x and y, and about z, everything fits
    slipped = model.predict(T)
    slipped[0, 3] += 0.05  # noise of the measurement: the velocity along x does not learn from it
    before = model.predict(T)[:3, 3] - T[:3, 3]
    model.update(T, slipped, wall, 0.008)
    after = model.predict(slipped)[:3, 3] - slipped[:3, 3]
    torch.testing.assert_close(after[:2], before[:2], rtol=0, atol=1e-3)

    roll = MotionModel()
    roll.T_step = se3.exp(torch.tensor([0, 0, 0, 0, 0, 0.02], dtype=torch.float64))
    T = EYE
    for _ in range(10):
        T_next = roll.predict(T)
        roll.update(T, T_next, wall, 0.008)
        T = T_next
    assert float(se3.log(roll.T_step)[5]) == pytest.approx(0.02 * 0.9**10, rel=1e-3)
