"""Where the map has observed a surface: cells by hand, and a wall beside which an alignment follows images alone."""

import numpy as np
import torch

from idfslam.graph.observed_space import ObservedSpace, compiled_contains, plain_contains


def test_a_place_is_observed_within_half_a_cell_of_a_reading_and_not_beyond_one_and_a_half() -> None:
    space = ObservedSpace()
    reading = np.array([[1.0, -2.0, 0.31]])
    space.add(reading)
    generator = np.random.default_rng(0)
    offsets = generator.uniform(-0.15, 0.15, (4000, 3))
    found = space.contains(torch.from_numpy(reading + offsets)).numpy()
    reach = np.abs(offsets).max(1)
    assert found[reach < 0.03].all() and (reach < 0.03).sum() > 2
    assert not found[reach > 0.09].any()


def test_nothing_is_observed_at_first_and_readings_add_up() -> None:
    space, points = ObservedSpace(), torch.tensor([[0.0, 0.0, 1.0], [5.0, 0.0, 1.0]])
    assert space.contains(points).tolist() == [False, False]
    space.add(points[:1].numpy())
    assert space.contains(points).tolist() == [True, False]
    space.add(points[1:].numpy())
    space.add(np.zeros((0, 3)))
    assert space.contains(points).tolist() == [True, True]


def test_the_compiled_search_finds_what_the_plain_one_finds() -> None:
    space = ObservedSpace()
    space.add(np.random.default_rng(0).uniform(-0.5, 0.5, (60, 3)))
    cells, points = space.state()["cells"].numpy(), torch.rand(3000, 3, generator=torch.Generator().manual_seed(0)) - 0.5
    found = compiled_contains(cells, points)
    assert torch.equal(found, plain_contains(cells, points)) and 200 < found.sum() < 2800
    assert not compiled_contains(cells[:0], points).any()


def test_the_cells_are_its_state() -> None:
    space, restored = ObservedSpace(), ObservedSpace()
    space.add(np.random.default_rng(1).uniform(-50, 50, (300, 3)))
    restored.restore(space.state())
    points = torch.rand(2000, 3) * 100 - 50
    assert torch.equal(restored.contains(points), space.contains(points))
    assert 8 * 300 * 0.9 < len(space.state()["cells"]) <= 8 * 300
