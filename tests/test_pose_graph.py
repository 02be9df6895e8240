"""Loops bring a drifted circle back together, and wrong ones do not."""

import math

import pytest
import torch
from torch import Tensor

from idfslam.geometry import se3
from idfslam.graph.pose_graph import Edge, optimise

COUNT = 60


@pytest.fixture(scope="module")
def circle() -> tuple[list[Tensor], list[Tensor]]:
    """(true, drifted) poses round a circle of 30 m, 0.5 m apart."""
    noise = torch.randn(COUNT, 6, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    step = se3.exp(torch.tensor([0.5, 0, 0, 0, 0, 2 * math.pi / COUNT], dtype=torch.float64))
    true, drifted = [torch.eye(4, dtype=torch.float64)], [torch.eye(4, dtype=torch.float64)]
    for i in range(COUNT - 1):
        true.append(true[-1] @ step)
        drifted.append(drifted[-1] @ step @ se3.exp(noise[i] * torch.tensor([0.005] * 3 + [0.003] * 3)))
    return true, drifted


def links(poses: list[Tensor]) -> list[Edge]:
    return [Edge(i, i + 1, se3.inverse(poses[i]) @ poses[i + 1], 0.01, 0.005) for i in range(COUNT - 1)]


def loop(poses: list[Tensor], a: int, b: int, shift: float = 0.0) -> Edge:
    offset = se3.exp(torch.tensor([0, shift, 0, 0, 0, 0], dtype=torch.float64))
    return Edge(a, b, se3.inverse(poses[a]) @ poses[b] @ offset, 0.005, 0.002, loop=True)


def worst(poses: list[Tensor], true: list[Tensor]) -> float:
    return max(float((a - b)[:3, 3].norm()) for a, b in zip(poses, true))


def test_a_loop_takes_most_of_the_drift_away(circle: tuple[list[Tensor], list[Tensor]]) -> None:
    true, drifted = circle
    poses, believed = optimise(drifted, [*links(drifted), loop(true, 0, COUNT - 1)])
    assert believed == [True]
    assert torch.equal(poses[0], drifted[0])
    assert float((poses[-1] - true[-1])[:3, 3].norm()) < 0.01 < 0.15 < float((drifted[-1] - true[-1])[:3, 3].norm())
    assert worst(poses, true) < 0.5 * worst(drifted, true)


def test_a_wrong_loop_is_told_from_right_ones(circle: tuple[list[Tensor], list[Tensor]]) -> None:
    true, drifted = circle
    wrong = loop(true, 5, 35, shift=1.5)  # the door beside the right one
    poses, believed = optimise(drifted, [*links(drifted), loop(true, 0, COUNT - 1), wrong, loop(true, 1, COUNT - 2)])
    assert believed == [True, False, True]
    assert worst(poses, true) < 0.5 * worst(drifted, true)


def test_without_loops_poses_stay(circle: tuple[list[Tensor], list[Tensor]]) -> None:
    _, drifted = circle
    poses, believed = optimise(drifted, links(drifted))
    assert believed == []
    assert worst(poses, drifted) < 1e-6
