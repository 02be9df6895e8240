"""Procrustes: exact by hand, reflections, gradients; the robust form under outliers."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from idfslam.geometry import se3
from idfslam.tracking.procrustes import best_subset, procrustes, random_subsets, register, residuals


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def cloud(count: int, seed: int = 0) -> Tensor:
    return torch.rand(count, 3, generator=generator(seed), dtype=torch.float64) * 2 - 1


def test_quarter_turn_by_hand() -> None:
    # A quarter turn about z and a shift of (1, 2, 3): x -> y, y -> -x. (1,0,0) -> (1,3,3), (0,1,0) -> (0,2,3), (0,0,1) -> (1,2,4).
    source = torch.eye(3, dtype=torch.float64)
    target = torch.tensor([[1.0, 3, 3], [0, 2, 3], [1, 2, 4]], dtype=torch.float64)
    expected = torch.tensor([[0.0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]], dtype=torch.float64)
    torch.testing.assert_close(procrustes(source, target, torch.ones(3)), expected)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.floats(-1.5, 1.5), min_size=6, max_size=6), st.integers(0, 100))
def test_exact_without_noise(increment: list[float], seed: int) -> None:
    T = se3.exp(torch.tensor(increment, dtype=torch.float64))
    source = cloud(10, seed)
    weight = torch.rand(10, generator=generator(seed)) + 0.1
    torch.testing.assert_close(procrustes(source, se3.transform(T, source), weight), T, atol=1e-9, rtol=0)


def test_weights_decide() -> None:
    # Two points moved by +1 and +4 along x with weights 2 and 1: the mean shift is (2*1 + 1*4)/3 = 2.
    source = torch.tensor([[0.0, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=torch.float64)
    shift = torch.tensor([1.0, 4.0, 0.0], dtype=torch.float64)
    target = source.clone()
    target[:, 0] += shift
    T = procrustes(source, target, torch.tensor([2.0, 1.0, 0.0]))
    centroid = torch.tensor([[0.0, 1 / 3, 0]], dtype=torch.float64)  # of the weighted sources
    assert float(se3.transform(T, centroid)[0, 0]) == pytest.approx(2.0)


def test_never_a_reflection() -> None:
    source = cloud(6)
    T = procrustes(source, source * torch.tensor([1.0, 1, -1], dtype=torch.float64), torch.ones(6))
    assert float(torch.det(T[:3, :3])) == pytest.approx(1.0)


def test_a_plane_is_enough() -> None:
    T = se3.exp(torch.tensor([0.3, -0.2, 0.1, 0.2, 0.4, -0.3], dtype=torch.float64))
    source = cloud(8) * torch.tensor([1.0, 1, 0], dtype=torch.float64)
    torch.testing.assert_close(procrustes(source, se3.transform(T, source), torch.ones(8)), T)


def test_gradients_match_finite_differences() -> None:
    source, weight = cloud(6, 1), torch.rand(6, generator=generator(2), dtype=torch.float64) + 0.5
    target = se3.transform(se3.exp(torch.tensor([0.1, 0.2, 0.3, 0.3, -0.2, 0.1], dtype=torch.float64)), source) + 0.1 * cloud(6, 3)
    inputs = tuple(x.requires_grad_() for x in (source, target, weight))
    assert torch.autograd.gradcheck(procrustes, inputs)


def test_best_subset_is_the_one_with_least_residual_over_all() -> None:
    # Four points agree on the identity, the fifth is 9 m off: a subset without it leaves 9 m of one match, the least that can be.
    source = cloud(5)
    target = source.clone()
    target[4, 0] += 9
    chosen = best_subset(source, target, torch.ones(5), random_subsets(5, subsets=50, share=0.6, generator=generator()))
    assert 4 not in chosen.tolist()
    assert len(chosen) == 3


@pytest.mark.parametrize(("truncation", "refits"), [(0.0, 0), (0.1, 3)])
def test_half_outliers(truncation: float, refits: int) -> None:
    # 200 matches, half of them anywhere in the room, the others with 5 mm of noise: the truth within 2 cm and 1.5 degrees.
    T = se3.exp(torch.tensor([0.1, -0.05, 0.2, 0.1, 0.2, -0.1], dtype=torch.float64))
    source = cloud(200)
    target = se3.transform(T, source) + 0.005 * torch.randn(200, 3, generator=generator(1))
    target[::2] = 2 * cloud(100, 5)
    found = register(
        source,
        target,
        torch.ones(200, dtype=torch.float64),
        random_subsets(200, subsets=1000, share=0.015, generator=generator()),
        inlier_distance=0.05,
        truncation=truncation,
        refits=refits,
    )
    delta = se3.inverse(T) @ found.T_ab
    assert float(delta[:3, 3].norm()) < 0.02
    assert math.degrees(float(se3.angle(delta))) < 1.5
    assert int(found.inliers[1::2].sum()) > 90
    assert found.rmse < 0.03


def test_inliers_and_rmse_by_hand() -> None:
    # The identity, residuals 0, 0, 0, 0 and one match 1 m off: four inliers, rmse 0.
    source = cloud(5)
    target = source.clone()
    target[4, 2] += 1
    subsets = random_subsets(5, subsets=50, share=0.6, generator=generator())
    found = register(source, target, torch.ones(5), subsets, inlier_distance=0.05)
    assert found.inliers.tolist() == [True, True, True, True, False]
    assert found.rmse == pytest.approx(0, abs=1e-9)


def test_gradients_reach_the_weights_through_the_winner() -> None:
    source = cloud(30)
    target = source + 0.01 * cloud(30, 7)
    weight = torch.ones(30, dtype=torch.float64, requires_grad=True)
    found = register(source, target, weight, random_subsets(30, subsets=10, share=0.2, generator=generator()), inlier_distance=0.05)
    residuals(found.T_ab, source, target).sum().backward()
    assert weight.grad is not None
    assert int((weight.grad != 0).sum()) == 6  # 20 % of 30 formed the winning subset
