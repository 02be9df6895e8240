"""Evenly spread members of a sequence: both ends, no member twice, all of a short one."""

import numpy as np
import pytest

from idfslam.geometry.even_spacing import evenly_spread


@pytest.mark.parametrize(("length", "count", "expected"), [(5, 3, [0, 2, 4]), (4, 9, [0, 1, 2, 3]), (7, 1, [0]), (0, 4, []), (6, 0, [])])
def test_indices(length: int, count: int, expected: list[int]) -> None:
    assert evenly_spread(length, count).tolist() == expected


def test_steps_differ_by_one_at_most() -> None:
    steps = np.diff(evenly_spread(100, 7))
    assert len(steps) == 6
    assert steps.max() - steps.min() <= 1
