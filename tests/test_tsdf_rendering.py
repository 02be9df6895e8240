import math

import pytest
import torch
from torch import Tensor

from idfslam.geometry import se3
from idfslam.geometry.camera import Camera
from idfslam.mapping.losses import LossWeights, rendering_losses
from idfslam.mapping.tsdf_rendering import (
    RayMarch,
    importance_depths,
    render,
    render_weights,
    stratified_depths,
    world_rays,
    zero_crossing,
)

TR = 0.1
CAMERA = Camera(16, 12, 14.0, 14.0, 7.5, 5.5)


def sphere(points: Tensor, directions: Tensor) -> tuple[Tensor, Tensor]:
    """A ball of radius 0.5 m, 2 m in front of the world's origin; its colour varies smoothly in space."""
    centre = torch.tensor([0.0, 0, 2], dtype=points.dtype)
    sdf = ((points - centre).norm(dim=-1) - 0.5) / TR
    return torch.tanh(sdf), 0.5 + 0.3 * torch.sin(3 * points) + 0.01 * directions


def test_world_rays() -> None:
    # The camera looks along world x after a quarter turn about y; pixel (7.5 + 14, 5.5) is at (1, 0, 1) in the camera.
    T_wc = se3.exp(torch.tensor([1.0, 2, 3, 0, math.pi / 2, 0], dtype=torch.float64))
    T_wc[:3, 3] = torch.tensor([1.0, 2, 3])
    origins, directions = world_rays(T_wc, CAMERA, torch.tensor([[21.5, 5.5]]))
    torch.testing.assert_close(origins, torch.tensor([[1.0, 2, 3]], dtype=torch.float64))
    torch.testing.assert_close(directions, torch.tensor([[1.0, 0, -1]], dtype=torch.float64))
    batched = world_rays(T_wc.expand(2, 4, 4), CAMERA, torch.tensor([[21.5, 5.5], [7.5, 5.5]]))[1]
    torch.testing.assert_close(batched, torch.tensor([[1.0, 0, -1], [1, 0, 0]], dtype=torch.float64))


def test_stratified_depths() -> None:
    # Four parts of [1, 5] and of [1, 3]: middles 1.5, 2.5, ... and 1.25, 1.75, ...
    far = torch.tensor([5.0, 3.0])
    assert stratified_depths(1.0, far, 4).tolist() == [[1.5, 2.5, 3.5, 4.5], [1.25, 1.75, 2.25, 2.75]]
    drawn = stratified_depths(1.0, far.expand(2), 4, torch.Generator().manual_seed(3))
    assert bool(((drawn[0] - torch.tensor([1.5, 2.5, 3.5, 4.5])).abs() <= 0.5).all())
    assert torch.equal(drawn, stratified_depths(1.0, far, 4, torch.Generator().manual_seed(3)))


def test_importance_depths_invert_the_cdf() -> None:
    # All weight on the sample at 2 m, which owns [1.5, 2.5]: the quantiles 1/8, 3/8, 5/8, 7/8 fall at 1.625, 1.875, ...
    depths = torch.tensor([[1.0, 2, 3, 4]])
    found = importance_depths(depths, torch.tensor([[0.0, 1, 0, 0]]), 4)
    torch.testing.assert_close(found, torch.tensor([[1.625, 1.875, 2.125, 2.375]]), atol=1e-4, rtol=0)
    # Without weight they spread over the four parts [1, 1.5], [1.5, 2.5], [2.5, 3.5], [3.5, 4], a quarter of the mass each.
    even = importance_depths(depths, torch.zeros(1, 4), 4)
    torch.testing.assert_close(even, torch.tensor([[1.25, 2.0, 3.0, 3.75]]), atol=1e-4, rtol=0)


def test_zero_crossing() -> None:
    sdf = torch.tensor([[1.0, 0.5, -0.5, 1], [1, 1, 1, 1], [-1, 1, -3, 1], [-1, -1, -1, -1]])
    depths = torch.tensor([1.0, 2, 3, 4]).expand(4, 4)
    # Half way between 2 and 3; none; a quarter of the way from 2 to 3 (the rise from behind before it is no surface); none.
    assert zero_crossing(sdf, depths).tolist() == [2.5, math.inf, 2.25, math.inf]


def test_weights_by_hand() -> None:
    # s = 2: sigmoid(2 D) sigmoid(-2 D) is 1/4 at 0, 0.104994 at D = +-1, cut beyond the crossing at 1.0 m + 0.1 m: 0 at 1.2 m.
    sdf = torch.tensor([[1.0, 0, -1, -1]])
    depths = torch.tensor([[0.9, 1.0, 1.1, 1.2]])
    bell = torch.tensor([[0.104994, 0.25, 0.104994, 0]])
    torch.testing.assert_close(render_weights(sdf, depths, 0.1 + 1e-6, 2.0), bell / 0.459988, atol=1e-5, rtol=0)


def test_weights_peak_at_the_crossing_and_sum_to_one() -> None:
    depths = torch.linspace(0.5, 3, 101)[None]
    sdf = ((2.0 - depths) / TR).clamp(-1, 1)
    weights = render_weights(sdf, depths, TR, 10.0)
    assert depths[0, weights[0].argmax()] == pytest.approx(2.0, abs=1e-5)
    assert float(weights.sum()) == pytest.approx(1.0, abs=1e-5)
    assert float(weights[depths > 2.1 + 1e-5].sum()) == 0


def test_second_surface_does_not_shine_through() -> None:
    depths = torch.linspace(0.5, 3, 251)[None]
    two = torch.minimum((1.0 - depths).abs() - 0.15, (2.5 - depths).abs() - 0.15) / TR  # two boards, 0.85 and 2.35 m
    weights = render_weights(two.clamp(-1, 1), depths, TR, 10.0)
    assert float((weights * depths).sum()) == pytest.approx(0.85, abs=0.03)


def test_depth_of_a_sphere() -> None:
    # The central ray meets the ball at 1.5 m; that of the corner passes it.
    origins, directions = world_rays(torch.eye(4), CAMERA, torch.tensor([[7.0, 5.0], [0.0, 0.0]]))
    rendered = render(sphere, origins, directions, torch.full((2,), 4.0), RayMarch(128, 16, TR, 20.0))
    assert float(rendered.depth[0]) == pytest.approx(1.5, abs=0.01)
    assert zero_crossing(rendered.sdf, rendered.depths).isfinite().tolist() == [True, False]
    again = render(sphere, origins, directions, torch.full((2,), 4.0), RayMarch(128, 16, TR, 20.0))
    torch.testing.assert_close(rendered.depth, again.depth)  # without a generator the samples are placed evenly


def test_importance_samples_join_in_order() -> None:
    origins, directions = world_rays(torch.eye(4), CAMERA, torch.tensor([[7.0, 5.0], [8.0, 6.0]]))
    rendered = render(
        sphere, origins, directions, torch.tensor([4.0, 3.0]), RayMarch(32, 16, TR, 10.0), generator=torch.Generator().manual_seed(0)
    )
    assert rendered.depths.shape == rendered.sdf.shape == rendered.weights.shape == (2, 48)
    assert bool((rendered.depths.diff(dim=1) >= 0).all())
    assert int(((rendered.depths - 1.5).abs() < 0.2).sum()) >= 24  # the importance samples lie about the surface
    points = origins[:, None] + directions[:, None] * rendered.depths[..., None]
    torch.testing.assert_close(rendered.sdf, sphere(points.view(-1, 3), points.view(-1, 3))[0].view(2, 48))


def test_pose_gradient_against_finite_differences() -> None:
    uv = torch.tensor([[7.0, 5.0], [9.0, 6.0], [5.0, 4.0], [0.0, 0.0]])
    target_colour = torch.full((4, 3), 0.4, dtype=torch.float64)
    target_depth = torch.tensor([1.52, 1.55, 1.5, 0], dtype=torch.float64)
    march = RayMarch(64, 0, TR, 5.0)
    T_wc = se3.exp(torch.tensor([0.02, -0.03, 0.01, 0.02, 0.01, -0.02], dtype=torch.float64))

    def loss(xi: Tensor) -> Tensor:
        origins, directions = world_rays(T_wc @ se3.exp(xi), CAMERA, uv)
        rendered = render(sphere, origins, directions, torch.full((4,), 3.0, dtype=torch.float64), march)
        return rendering_losses(rendered, target_colour, target_depth, TR, LossWeights(truncation=60.0)).total

    xi = torch.zeros(6, dtype=torch.float64, requires_grad=True)
    (gradient,) = torch.autograd.grad(loss(xi), xi)
    step = 1e-6 * torch.eye(6, dtype=torch.float64)
    numeric = torch.stack([(loss(s) - loss(-s)) / 2e-6 for s in step])
    assert float(numeric.abs().min()) > 1e-4  # the test would say nothing of a direction without effect
    torch.testing.assert_close(gradient, numeric, atol=1e-5, rtol=1e-4)
