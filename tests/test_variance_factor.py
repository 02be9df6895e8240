"""The variance factor a posteriori, by hand: two measurements of a pose that agree or not, and distances above the sensor's noise."""

import numpy as np
import pytest

from idfslam.alignment import variance_factor as module
from idfslam.alignment.depth_term import DepthTerm
from idfslam.alignment.gauss_newton import INDEPENDENT
from idfslam.alignment.image_term import ImageTerm
from idfslam.alignment.row_moments import RowMoments
from idfslam.alignment.variance_factor import variance_factor

NOISE, STILL = 0.0015, np.zeros(6)


def sums(information: float, pull: float) -> RowMoments:
    """Information [1/m^2] in each direction, and a pull of so many metres along x; in units of depth."""
    H = information * np.eye(6)[None] * NOISE**2
    return RowMoments(H, H[:, :, 0] * pull)


def depth(information: float, pull: float, rmse: float = NOISE) -> DepthTerm:
    return DepthTerm(sums(information, pull), 1000.0, 1.0, rmse, 1.0, 2.0)


def images(*parts: RowMoments) -> ImageTerm:
    return ImageTerm(sum(parts, RowMoments.zeros(moments=False)), 0.01, 1.0, parts)


def test_measurements_that_agree_leave_what_they_may_by_chance(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_BY_CHANCE", 0.25)
    assert variance_factor(depth(1e7, 0.0), images(sums(1e7, 0.0)), STILL, NOISE) == 0.25


def test_measurements_that_contradict_each_other(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_BY_CHANCE", 0.0)
    # each is 3 mm from the common solution: chi-squared 1e7 * 9e-6 = 90 each, 180 together, of 6 degrees of freedom
    found = variance_factor(depth(1e7, 0.003), images(sums(1e7, -0.003)), STILL, NOISE)
    assert found == pytest.approx(INDEPENDENT * 180 / 6, rel=1e-5)
    # the pose moved by 1 mm along x after them: one is 2 mm off, the other 4 mm, so that chi-squared is 40 + 160
    moved = np.array([0.001, 0, 0, 0, 0, 0])
    found = variance_factor(depth(1e7, 0.003), images(sums(1e7, -0.003)), moved, NOISE)
    assert found == pytest.approx(INDEPENDENT * 200 / 6, rel=1e-5)


def test_distances_above_the_noise_count_twice() -> None:
    as_noise, below, twice = (variance_factor(depth(1e7, 0.0, rmse), images(), STILL, NOISE) for rmse in (NOISE, NOISE / 2, 2 * NOISE))
    assert as_noise == below == 1.5  # there is nothing to compare
    assert twice == pytest.approx(16 * as_noise)


def test_a_frame_without_depth() -> None:
    absent = DepthTerm.absent(weight=1.0, radius=2.0, moments=False)
    assert variance_factor(absent, images(sums(1e7, 0.0), sums(1e7, 0.0)), STILL, NOISE) == 0.5
