"""Keys of blocks: each once, in order."""

import numpy as np

from idfslam.geometry.blocks import distinct, pack, unpack


def test_distinct_keys_are_those_of_numpy() -> None:
    keys = np.random.default_rng(0).integers(-50, 50, (40, 8))
    assert distinct(keys).tolist() == np.unique(keys).tolist()
    assert distinct(np.array([7])).tolist() == [7]
    assert distinct(np.empty(0, np.int64)).tolist() == []


def test_unpacked_keys_are_the_coordinates() -> None:
    coordinates = np.array([[0, 0, 0], [-3, 5, 1_000_000], [7, -1_000_000, 2]])
    assert unpack(pack(coordinates)).tolist() == coordinates.tolist()
