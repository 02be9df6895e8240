"""The samples objective's targets and weights by hand, and the two objectives' common ground."""

import pytest
import torch

from idfslam.config import FieldConfig, MapperConfig
from idfslam.mapping.field import Field
from idfslam.mapping.objectives import RenderingObjective, SampleObjective, far_depth
from idfslam.mapping.rays import Rays
from idfslam.sensing.depth_noise import noise_ratio

CONFIG = MapperConfig(
    samples=4, importance_samples=2, photometric_weight=2.0, free_space_weight=0.2, truncation_weight=10.0, free_margin=0.6
)
TRUNCATION = 0.1


def rays(*depth: float, cos_incidence: float = 1.0) -> Rays:
    """Along z from the origin."""
    n = len(depth)
    colour = torch.linspace(0, 1, 3 * n).view(n, 3)
    return Rays(
        torch.zeros(n, 3), torch.tensor([[0.0, 0.0, 1.0]]).expand(n, 3), torch.tensor(depth), colour, torch.full((n,), cos_incidence)
    )


def generator() -> torch.Generator:
    return torch.Generator().manual_seed(0)


def test_noise_grows_with_the_square_of_depth() -> None:
    torch.testing.assert_close(noise_ratio(torch.tensor([0.2, 0.4, 1.4, 2.4])), torch.tensor([1.0, 1.0, 2.5, 7.0]))


def test_far_depth_ends_behind_the_surface() -> None:
    torch.testing.assert_close(far_depth(rays(1.0, 0.0, 3.0), 0.1), torch.tensor([1.2, 3.2, 3.2]))


@pytest.mark.parametrize("cos_incidence", [1.0, 0.5])
def test_samples_near_the_surface(cos_incidence: float) -> None:
    # Each in its own quarter of [depth - tr, depth + tr].
    # A surface turned away: a centimetre along the ray is half a centimetre from its plane.
    samples = SampleObjective(CONFIG, TRUNCATION).samples(rays(1.0, 2.0, cos_incidence=cos_incidence), generator())
    assert samples.near == 2 * 4
    z = samples.points[: samples.near, 2].view(2, 4)
    depth = torch.tensor([[1.0], [2.0]])
    quarters = (z - depth + TRUNCATION) / (2 * TRUNCATION) * 4
    assert (quarters >= torch.arange(4) - 1e-4).all()
    assert (quarters <= torch.arange(1, 5) + 1e-4).all()
    torch.testing.assert_close(samples.target[: samples.near].view(2, 4), (depth - z) * cos_incidence / TRUNCATION, rtol=1e-4, atol=1e-5)
    assert (samples.points[:, :2] == 0).all()


def test_samples_in_free_space_end_before_the_truncation() -> None:
    samples = SampleObjective(CONFIG, TRUNCATION).samples(rays(1.0, 2.0), generator())
    z = samples.points[samples.near :, 2].view(2, 2)
    assert (z >= 0.05 - 1e-6).all()
    assert (z <= torch.tensor([[0.9], [1.9]]) + 1e-6).all()
    assert (z[:, 1] > z[:, 0]).all()  # one in each half


def test_weights_sum_to_the_shares() -> None:
    samples = SampleObjective(CONFIG, TRUNCATION).samples(rays(1.0, 2.0, 3.0), generator())
    assert float(samples.weight[: samples.near].sum()) == pytest.approx(10.0)
    assert float(samples.weight[samples.near :].sum()) == pytest.approx(0.2)
    assert float(samples.colour_weight.sum()) == pytest.approx(2.0)
    torch.testing.assert_close(samples.colour.view(3, 4, 3)[:, 2], rays(1.0, 2.0, 3.0).colour)


class Constant(Field):
    """A T-SDF and a colour that are the same everywhere."""

    def __init__(self, value: float, colour: float) -> None:
        super().__init__(FieldConfig(encoding="positional", layers=1, width=8))
        self.value, self.colour = value, colour

    def sdf(self, points: torch.Tensor) -> torch.Tensor:
        return torch.full((len(points),), self.value)

    def forward(self, points: torch.Tensor, directions: torch.Tensor | None = None) -> tuple[torch.Tensor, torch.Tensor]:
        return self.sdf(points), torch.full((len(points), 3), self.colour)


def test_losses_by_hand() -> None:
    # T-SDF 0.4 everywhere. Free space asks for 0.6: (0.2)^2 = 0.04. Colour 0.5 against 0, 0.5, 1: (0.5 + 0 + 0.5) / 3 = 1/3.
    objective = SampleObjective(CONFIG, TRUNCATION)
    losses = objective(Constant(0.4, 0.5), rays(1.0), generator())
    target = objective.samples(rays(1.0), generator()).target[:4]
    assert float(losses.free_space) == pytest.approx(0.04, rel=1e-4)
    assert float(losses.photometric) == pytest.approx(1 / 3, rel=1e-4)
    assert float(losses.truncation) == pytest.approx(float(((0.4 - target) ** 2).mean()), rel=1e-4)
    assert float(losses.total) == pytest.approx(2 / 3 + 0.2 * 0.04 + 10 * float(losses.truncation), rel=1e-4)


def test_free_space_bounds_from_below_alone() -> None:
    assert float(SampleObjective(CONFIG, TRUNCATION)(Constant(0.9, 0.5), rays(1.0, 2.0), generator()).free_space) == 0


@pytest.mark.parametrize("objective", [SampleObjective(CONFIG, TRUNCATION), RenderingObjective(CONFIG, TRUNCATION)])
def test_the_rays_shares_average_to_the_total(objective: SampleObjective | RenderingObjective) -> None:
    torch.manual_seed(0)
    field = Field(FieldConfig(encoding="positional", layers=2, width=16, truncation=TRUNCATION))
    losses = objective.learn(field, rays(1.0, 2.0, 1.5), generator())
    assert losses.per_ray.shape == (3,)
    assert not losses.per_ray.requires_grad
    assert float(losses.per_ray.mean()) == pytest.approx(float(losses.total.detach()), rel=1e-4)
    assert float(field.sdf_head.weight.grad.norm()) > 0
