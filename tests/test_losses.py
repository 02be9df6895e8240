import math

import pytest
import torch

from idfslam.geometry import se3
from idfslam.mapping.losses import geometric_residuals, photometric_residuals, rendering_losses
from idfslam.mapping.tsdf_rendering import Rendered
from idfslam.tracking.finetuning import correspondence_loss, depth_loss

TR = 0.1
# Two rays. The first measures 1.0 m: its samples at 0.5 and 0.8 are free space, 0.95 and 1.05 lie in the truncation region (targets
# +0.05 and -0.05 m), 1.5 is behind. The second has no depth.
DEPTHS = torch.tensor([[0.5, 0.8, 0.95, 1.05, 1.5]] * 2)
SDF = torch.tensor([[0.9, 0.5, 0.3, -0.7, 5.0], [9.0] * 5])
TARGET = torch.tensor([1.0, 0.0])
COLOUR = torch.tensor([[0.5, 0.5, 0.5], [1.0, 0, 0]])
TARGET_COLOUR = torch.tensor([[0.5, 0.8, 0.9], [1.0, 0, 0.25]])  # norms 0.5 and 0.25


def rendered() -> Rendered:
    return Rendered(COLOUR, torch.ones(2), SDF, DEPTHS, torch.full((2, 5), 0.2))


def test_photometric_loss_eq_1() -> None:
    torch.testing.assert_close(photometric_residuals(COLOUR, TARGET_COLOUR), torch.tensor([0.25, 0.0625]))


def test_photometric_gradient_is_finite_where_colours_agree() -> None:
    colour = TARGET_COLOUR.clone().requires_grad_()
    photometric_residuals(colour, TARGET_COLOUR).sum().backward()
    assert colour.grad is not None and bool((colour.grad == 0).all())


def test_geometric_loss_eq_2() -> None:
    free, near, share = geometric_residuals(SDF, DEPTHS, TARGET, TR)
    torch.testing.assert_close(free, torch.tensor([0.13, 0]))  # ((0.9 - 1)^2 + (0.5 - 1)^2) / 2, in units of tr
    torch.testing.assert_close(near, torch.tensor([0.0004, 0]))  # ((0.03 - 0.05)^2 + (-0.07 + 0.05)^2) / 2 m^2
    assert float(share) == 0.5


def test_weighted_sum_eq_3() -> None:
    # Means over |B| = 2 rays: L_fs 0.065, L_tr 0.0002, L_p 0.15625. Half of the samples are free space: both classes are weighted by 1/2.
    # 10 * 0.5 * 0.065 + 6000 * 0.5 * 0.0002 + 0.1 * 0.15625 = 0.940625.
    losses = rendering_losses(rendered(), TARGET_COLOUR, TARGET, TR)
    assert float(losses.free_space) == pytest.approx(0.065)
    assert float(losses.truncation) == pytest.approx(0.0002, rel=1e-5)
    assert float(losses.photometric) == pytest.approx(0.15625)
    assert float(losses.total) == pytest.approx(0.940625, rel=1e-5)
    # The first ray costs 5 * 0.13 + 3000 * 0.0004 + 0.1 * 0.25; the one without depth 0.1 * 0.0625.
    torch.testing.assert_close(losses.per_ray, torch.tensor([1.875, 0.00625]), atol=0, rtol=1e-5)


def test_class_balance() -> None:
    # Five samples: three in free space, two in the truncation region: free space is weighted by 2/5, truncation by 3/5.
    depths = torch.tensor([[0.5, 0.6, 0.7, 0.95, 1.05]])
    sdf = torch.tensor([[0.0, 0, 0, 0.5, 0.5]])  # L_fs = 1, L_tr = (0 + 0.1^2) / 2
    one = Rendered(torch.zeros(1, 3), torch.ones(1), sdf, depths, torch.full((1, 5), 0.2))
    losses = rendering_losses(one, torch.zeros(1, 3), torch.ones(1), TR)
    assert float(losses.total) == pytest.approx(10 * 0.4 * 1 + 6000 * 0.6 * 0.005)


def test_perfect_prediction_costs_nothing() -> None:
    depths = torch.linspace(0.1, 2, 50)[None]
    sdf = ((1.3 - depths) / TR).clamp(-1, 1)
    perfect = Rendered(torch.ones(1, 3), torch.ones(1), sdf, depths, torch.full((1, 50), 0.02))
    assert float(rendering_losses(perfect, torch.ones(1, 3), torch.tensor([1.3]), TR).total) == pytest.approx(0, abs=1e-3)


def test_no_depth_anywhere_leaves_colour() -> None:
    losses = rendering_losses(rendered(), TARGET_COLOUR, torch.zeros(2), TR)
    assert float(losses.total) == pytest.approx(0.015625)  # 0.1 * (0.25 + 0.0625) / 2


def test_depth_loss_eq_7() -> None:
    # Readings 1 and 3 against 1.25 and 2.5; the third ray has none: (0.25 + 0.5) / 2.
    assert float(depth_loss(torch.tensor([1.25, 2.5, 7]), torch.tensor([1.0, 3, 0]))) == 0.375
    assert float(depth_loss(torch.tensor([1.25]), torch.zeros(1))) == 0


def test_correspondence_loss_eq_8() -> None:
    # A quarter turn about z and a step of 1 along x takes (1, 0, 0) to (1, 1, 0): 3 away from (1, 1, 3), weight 0.5;
    # and (0, 2, 5) to (-1, 0, 5): 0 away, weight 1. Mean of 1.5 and 0.
    T_rc = se3.exp(torch.tensor([0.0, 0, 0, 0, 0, math.pi / 2]))
    T_rc[:3, 3] = torch.tensor([1.0, 0, 0])
    points_c = torch.tensor([[1.0, 0, 0], [0, 2, 5]])
    points_r = torch.tensor([[1.0, 1, 3], [-1, 0, 5]])
    assert float(correspondence_loss(points_r, points_c, T_rc, torch.tensor([0.5, 1.0]))) == pytest.approx(0.75, abs=1e-6)
