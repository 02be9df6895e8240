"""Volume rendering of occupancy, by numbers worked out by hand."""

import math

import torch
from torch import Tensor

from idfslam.mapping.occupancy_rendering import (
    composite,
    farthest_sample,
    hierarchical_depths,
    near_surface_depths,
    occupancy_of_density,
    sample_lengths,
    termination,
    volume_render,
)


def test_occupancy_from_density() -> None:
    # 1 - exp(-ln 2 * 1) = 1/2, 1 - exp(-2 ln 2) = 3/4, nothing at density 0
    density = torch.tensor([math.log(2), 2 * math.log(2), 0.0])
    torch.testing.assert_close(occupancy_of_density(density, torch.ones(3)), torch.tensor([0.5, 0.75, 0.0]))
    torch.testing.assert_close(occupancy_of_density(density, torch.full((3,), 2.0)), torch.tensor([0.75, 0.9375, 0.0]))


def test_where_a_ray_ends() -> None:
    # 1/2; of the half that is left 1/2; of the quarter that is left all; nothing reaches the last sample
    weights = termination(torch.tensor([[0.5, 0.5, 1.0, 0.5], [0.0, 0.0, 0.0, 0.25]]))
    torch.testing.assert_close(weights, torch.tensor([[0.5, 0.25, 0.25, 0.0], [0.0, 0.0, 0.0, 0.25]]), atol=1e-6, rtol=0)


def test_depth_variance_and_colour() -> None:
    # weights 1/2, 1/4, 1/4 at 1, 2, 4 m: depth 2 m; variance 1/2 * 1 + 1/4 * 0 + 1/4 * 4 = 1.5 m^2
    colour = torch.tensor([[[1.0, 0, 0], [0, 1, 0], [0, 0, 1]]])
    rays = composite(torch.tensor([[0.5, 0.5, 1.0]]), colour, torch.tensor([[1.0, 2.0, 4.0]]))
    torch.testing.assert_close(rays.depth, torch.tensor([2.0]), atol=1e-6, rtol=0)
    torch.testing.assert_close(rays.variance, torch.tensor([1.5]), atol=1e-6, rtol=0)
    torch.testing.assert_close(rays.colour, torch.tensor([[0.5, 0.25, 0.25]]), atol=1e-6, rtol=0)


def test_lengths_of_samples() -> None:
    # a ray (0, 3/4, 1) is 5/4 m long for each metre of depth
    lengths = sample_lengths(torch.tensor([[1.0, 3.0, 4.0]]), torch.tensor([[0.0, 0.75, 1.0]]))
    torch.testing.assert_close(lengths[:, :2], torch.tensor([[2.5, 1.25]]))
    assert float(lengths[0, 2]) > 1e9


def wall(points: Tensor, steps: Tensor) -> tuple[Tensor, Tensor]:
    """Solid from z = 2 m on."""
    return (points[:, 2] >= 2).float(), torch.full_like(points, 0.25)


def test_a_wall_is_rendered_at_its_first_sample() -> None:
    origins, directions = torch.zeros(2, 3), torch.tensor([[0.0, 0, 1], [0.5, 0, 1]])
    depths = torch.tensor([[1.0, 1.9, 2.1, 3.0], [1.0, 1.5, 2.0, 2.5]])
    rays = volume_render(wall, origins, directions, depths)
    torch.testing.assert_close(rays.depth, torch.tensor([2.1, 2.0]))
    torch.testing.assert_close(rays.variance, torch.zeros(2), atol=1e-6, rtol=0)
    torch.testing.assert_close(rays.colour, torch.full((2, 3), 0.25))


def test_samples_end_behind_the_farthest_reading() -> None:
    assert float(farthest_sample(torch.tensor([1.0, 2.5, 0.0]))) == 3.0  # 1.2 * 2.5
    assert float(farthest_sample(torch.zeros(3))) == 1.0


def test_fine_samples_lie_where_the_coarse_ones_have_weight() -> None:
    origins, directions = torch.zeros(1, 3), torch.tensor([[0.0, 0, 1]])
    depths = hierarchical_depths(wall, origins, directions, torch.tensor(4.0), 8, 6, None)
    coarse = 0.25 + 0.5 * torch.arange(8)  # the middles of eight strata of 4 m
    assert depths.shape == (1, 14)
    assert bool((depths[:, 1:] >= depths[:, :-1]).all())
    fine = sorted(set(depths[0].tolist()) - set(coarse.tolist()))
    assert len(fine) == 6 and fine[0] >= 1.99 and fine[-1] <= 2.51  # all weight is at 2.25: between the middles 2 and 2.5


def test_samples_near_the_surface() -> None:
    # reading 2 m, end 3 m: 0.02, 1.01 + 0.5, 3; within 5 %: 1.9, 2.0, 2.1. Without a reading: 0 to the end, and 0 to the farthest reading
    depths = near_surface_depths(torch.tensor([2.0, 0.0]), torch.tensor(3.0), 3, 3)
    torch.testing.assert_close(depths, torch.tensor([[0.02, 1.51, 1.9, 2.0, 2.1, 3.0], [0.0, 0.0, 1.0, 1.5, 2.0, 3.0]]))
    assert near_surface_depths(torch.tensor([2.0]), torch.tensor(3.0), 4, 0).shape == (1, 4)
