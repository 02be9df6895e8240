"""Association of time stamps, worked out by hand; one to one, closest first."""

import numpy as np
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
