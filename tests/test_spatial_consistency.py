"""Matches that keep each other's distances: by hand, and among many outliers."""

import torch

from idfslam.geometry import se3
from idfslam.tracking.procrustes import random_subsets, register
from idfslam.tracking.spatial_consistency import consistent_subsets


def test_by_hand() -> None:
    # Four corners of a unit square moved by 5 m along x, and two matches that went elsewhere: corners are compatible with corners alone.
    source = torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0.5, 0.5, 0], [0.2, 0.7, 0]])
    target = source + torch.tensor([5.0, 0, 0])
    target[4:] += torch.tensor([[0.0, 3, 0], [0, 0, -2]])
    chosen = consistent_subsets(source, target, subsets=4, share=0.5, tolerance=0.05)
    assert chosen.shape == (4, 3)
    assert set(chosen.flatten().tolist()) <= {0, 1, 2, 3}


def test_nine_outliers_of_ten() -> None:
    # 20 of 200 matches are right, to within 5 mm. 100 random choices of ten are never all right (0.1^10); compatible ones are.
    draw = torch.Generator().manual_seed(0)
    T = se3.exp(torch.tensor([0.1, -0.2, 0.3, 0.2, 0.1, -0.3], dtype=torch.float64))
    source = 3 * torch.rand(200, 3, generator=draw, dtype=torch.float64)
    target = 3 * torch.rand(200, 3, generator=draw, dtype=torch.float64)
    target[::10] = se3.transform(T, source[::10]) + 0.005 * torch.randn(20, 3, generator=draw, dtype=torch.float64)
    fit = {"inlier_distance": 0.05, "truncation": 0.1, "refits": 3}
    proposed = {
        "random": random_subsets(200, subsets=100, share=0.05, generator=draw),
        "compatible": consistent_subsets(source, target, subsets=100, share=0.05, tolerance=0.05),
    }
    errors = {
        name: float((se3.inverse(T) @ register(source, target, torch.ones(200), subsets, **fit).T_ab)[:3, 3].norm())
        for name, subsets in proposed.items()
    }
    assert errors["compatible"] < 0.02
    assert errors["random"] > 0.2


def test_fewer_matches_than_subsets() -> None:
    source = torch.rand(5, 3, generator=torch.Generator().manual_seed(0))
    assert consistent_subsets(source, source, subsets=100, share=0.05, tolerance=0.05).shape == (5, 3)
