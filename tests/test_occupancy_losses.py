"""The losses of iMAP and NICE-SLAM, by numbers worked out by hand."""

import pytest
import torch
from torch import Tensor

from idfslam.mapping.joint.occupancy_losses import depth_and_colour_loss, variance_weighted_loss
from idfslam.mapping.occupancy_rendering import RenderedRays


def rendered(depth: list[float], deviation: list[float], colour: float = 0.5) -> RenderedRays:
    """Rays with these depths [m] and their deviations [m], all of one grey."""
    d, none = torch.tensor(depth, requires_grad=True), torch.zeros(len(depth), 1)
    return RenderedRays(torch.full((len(depth), 3), colour), d, torch.tensor(deviation).square(), none, none)


def grey(value: float, count: int) -> Tensor:
    return torch.full((count, 3), value)


def test_the_weighted_loss_of_imap() -> None:
    # e_g = 0.2, 0.1 m, none without a reading; over the deviations 0.1 and 0.5: 2, 0.2, 0. Their mean over three rays: 2.2 / 3.
    # e_p = 3 * 0.1 for each ray. Total: 2.2 / 3 + 5 * 0.3.
    losses = variance_weighted_loss(rendered([2.2, 0.9, 1.0], [0.1, 0.5, 0.2]), grey(0.6, 3), torch.tensor([2.0, 1.0, 0.0]), 5.0)
    assert float(losses.depth.detach()) == pytest.approx(2.2 / 3, abs=1e-5)
    assert float(losses.photometric.detach()) == pytest.approx(0.3, abs=1e-6)
    assert float(losses.total.detach()) == pytest.approx(2.2 / 3 + 1.5, abs=1e-5)
    torch.testing.assert_close(losses.per_ray, torch.tensor([0.5, 0.4, 0.3]))  # e_p + e_g, by which pixels are drawn


def test_no_gradient_makes_a_depth_unsure() -> None:
    rays = rendered([2.2], [0.1])
    variance = torch.tensor([0.01], requires_grad=True)
    losses = variance_weighted_loss(
        RenderedRays(rays.colour, rays.depth, variance, rays.weights, rays.depths), grey(0.5, 1), torch.tensor([2.0]), 5.0
    )
    losses.total.backward()
    assert variance.grad is None
    assert float(rays.depth.grad) == pytest.approx(10, rel=1e-4)  # 1 / 0.1


def test_the_tracking_loss_of_nice_leaves_outliers_out() -> None:
    # e_g over a deviation of 0.1: 0.1, 0.2, 0.3, 0.4, 30. The median is 0.3, so 30 > 10 * 0.3 is left out; so is the ray without a reading.
    depth = torch.tensor([1.0, 1.0, 1.0, 1.0, 1.0, 0.0])
    rays = rendered([1.01, 1.02, 1.03, 1.04, 4.0, 3.0], [0.1] * 6)
    losses = variance_weighted_loss(rays, grey(0.6, 6), depth, 0.5, outliers=10.0)
    assert float(losses.depth.detach()) == pytest.approx(1.0 / 6, abs=1e-5)
    assert float(losses.photometric.detach()) == pytest.approx(4 * 0.3 / 6, abs=1e-6)
    assert float(losses.total.detach()) == pytest.approx(1.0 / 6 + 0.5 * 0.2, abs=1e-5)
    losses.total.backward()
    assert [float(g) != 0 for g in rays.depth.grad] == [True, True, True, True, False, False]


def test_without_readings_only_colour_is_left() -> None:
    losses = variance_weighted_loss(rendered([1.0, 2.0], [0.1, 0.1]), grey(0.6, 2), torch.zeros(2), 0.5, outliers=10.0)
    assert float(losses.depth.detach()) == 0
    assert float(losses.total.detach()) == pytest.approx(0.15, abs=1e-6)


def test_the_mapping_loss_of_nice() -> None:
    # e_g = 0.2, 0.1 and none: mean 0.1 m; e_p = 0.3: total 0.1 + 0.2 * 0.3
    losses = depth_and_colour_loss(rendered([2.2, 0.9, 1.0], [0.1, 0.5, 0.2]), grey(0.6, 3), torch.tensor([2.0, 1.0, 0.0]), 0.2)
    assert float(losses.depth.detach()) == pytest.approx(0.1, abs=1e-6)
    assert float(losses.total.detach()) == pytest.approx(0.16, abs=1e-6)
