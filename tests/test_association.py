"""Association of time stamps, worked out by hand; one to one, closest first."""

import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from idfslam.geometry.association import associate


def test_association_takes_the_closest_first_and_each_image_once() -> None:
    colour = np.array([0.000, 0.030, 0.060, 0.200])
    depth = np.array([0.012, 0.028, 0.075, 0.221])
    # 30-28 ms (2 ms) comes first; then 0-12 (12); then 60-75 (15); 200-221 is 21 ms apart: too far
    assert associate(colour, depth, tolerance=0.02).tolist() == [[0, 0], [1, 1], [2, 2]]
    # both colour images are within 20 ms of the one depth image: only the nearer gets it
    assert associate([0.0, 0.010], [0.009], tolerance=0.02).tolist() == [[1, 0]]


def test_association_by_hand() -> None:
    # 0.00 takes 0.001; 0.10 is 19 ms from 0.119, which 0.12 (1 ms) takes first, so 0.10 takes 0.085; 0.50 has nothing within 20 ms
    pairs = associate([0.0, 0.10, 0.12, 0.5], [0.001, 0.085, 0.119, 0.53])
    assert pairs.tolist() == [[0, 0], [1, 1], [2, 2]]


def test_association_of_unsorted_stamps_and_of_none() -> None:
    assert associate([2.0, 1.0], [1.001, 2.001]).tolist() == [[0, 1], [1, 0]]
    assert associate([0.0], [1.0]).shape == (0, 2)
    assert associate([], [1.0]).shape == (0, 2)


@given(a=st.lists(st.floats(0, 1), max_size=30), b=st.lists(st.floats(0, 1), max_size=30), tolerance=st.floats(0.001, 0.2))
@settings(max_examples=60, deadline=None, derandomize=True)
def test_association_is_one_to_one_and_stable(a: list[float], b: list[float], tolerance: float) -> None:
    pairs = associate(a, b, tolerance=tolerance)
    i, j = pairs.T
    assert len(set(i.tolist())) == len(i) and len(set(j.tolist())) == len(j)
    assert all(abs(a[x] - b[y]) <= tolerance * (1 + 1e-9) for x, y in pairs)
    # Greedy: no pair left out could be taken without giving up a nearer one
    gap_a = {x: abs(a[x] - b[y]) for x, y in pairs.tolist()}
    gap_b = {y: abs(a[x] - b[y]) for x, y in pairs.tolist()}
    for x in range(len(a)):
        for y in range(len(b)):
            gap = abs(a[x] - b[y])
            if gap < tolerance * (1 - 1e-9):
                assert gap_a.get(x, np.inf) <= gap or gap_b.get(y, np.inf) <= gap


def by_all_pairs(a: list[float], b: list[float], tolerance: float) -> list[list[int]]:
    """The definition: of all pairs within the tolerance the closest first, then the lower index in a, then the earlier stamp in b."""
    gaps = sorted((abs(x - y), i, y, j) for i, x in enumerate(a) for j, y in enumerate(b) if abs(x - y) <= tolerance)
    pairs: dict[int, int] = {}
    for _, i, _, j in gaps:
        if i not in pairs and j not in pairs.values():
            pairs[i] = j
    return [[i, j] for i, j in sorted(pairs.items())]


stamps = st.lists(st.integers(0, 9).map(lambda i: i / 4) | st.integers(0, 2048).map(lambda i: i / 1024), max_size=14).map(sorted)


@given(a=stamps, b=stamps, tolerance=st.sampled_from([0.0, 0.25, 0.5, 3.0]))
@settings(max_examples=300, deadline=None, derandomize=True)
def test_association_is_the_one_of_its_definition_also_where_stamps_are_equal(a: list[float], b: list[float], tolerance: float) -> None:
    assert associate(a, b, tolerance=tolerance).tolist() == by_all_pairs(a, b, tolerance)


@pytest.mark.parametrize("spread", [0.0, 1e-6])  # [s] between stamps: all are within the tolerance of all
def test_the_time_of_association_does_not_grow_with_the_square_of_the_stamps(spread: float) -> None:
    start = time.process_time()
    pairs = associate(np.arange(20_000) * spread, np.arange(20_000) * spread)
    assert np.array_equal(pairs, np.repeat(np.arange(20_000)[:, None], 2, 1))
    assert time.process_time() - start < 10  # all pairs of 2 000 equal stamps took more than 30 s, of 20 000 an hour


def test_stamps_that_are_not_finite_have_no_partner() -> None:
    assert associate([np.nan, 1.0, np.inf], [np.inf, np.nan, 1.0]).tolist() == [[1, 2]]
