"""The small network's kernels against torch's autograd: learning, distance with gradient, and the T-SDF alone."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from helpers.plane_volume import plane_volume
from idfslam.config import FieldConfig, MapperConfig
from idfslam.mapping import compiled_field, sphere_tracing
from idfslam.mapping.field import Field
from idfslam.mapping.implicit_surface import ImplicitSurface
from idfslam.mapping.kernels.numba_field import BLOCK
from idfslam.mapping.losses import Losses
from idfslam.mapping.objectives import SampleObjective
from idfslam.mapping.optimiser import MapOptimiser
from idfslam.mapping.rays import Rays

SMALL = FieldConfig(encoding="grid", levels=4, table_log2=10, width=16, colour_width=12, truncation=0.1)
MAPPER = MapperConfig(supervision="samples", samples=5, importance_samples=3, free_margin=0.6)


def field(config: FieldConfig = SMALL, seed: int = 0) -> Field:
    """A field with features large enough that T-SDF and colour vary and both sides of every relu are met."""
    torch.manual_seed(seed)
    out = Field(config)
    with torch.no_grad():
        out.encoding.tables.uniform_(-0.7, 0.7)
        for p in out.parameters():
            if p.ndim == 1:
                p.uniform_(-0.3, 0.3)
    return out


def points(n: int) -> Tensor:
    return 3 * torch.rand(n, 3, generator=torch.Generator().manual_seed(n)) - 1.5


def rays(n: int) -> Rays:
    generator = torch.Generator().manual_seed(n)
    directions = torch.cat([torch.rand(n, 2, generator=generator) - 0.5, torch.ones(n, 1)], 1)
    depth, colour = 0.5 + 2 * torch.rand(n, generator=generator), torch.rand(n, 3, generator=generator)
    return Rays(torch.zeros(n, 3), directions, depth, colour, 0.3 + 0.7 * torch.rand(n, generator=generator))


def gradients(taught: Field) -> dict[str, Tensor]:
    """The tables' from the buffer that the optimiser reads, the others' from torch's parameters."""
    network = {name: p.grad.clone() for name, p in taught.named_parameters() if not name.endswith("tables") and p.grad is not None}
    return {"tables": taught.encoding.gradient.clone(), **network}


def learnt_compiled(n: int) -> tuple[Losses, dict[str, Tensor]]:
    taught = field()
    losses = SampleObjective(MAPPER, SMALL.truncation).learn(taught, rays(n), torch.Generator().manual_seed(1))
    return losses, gradients(taught)


def learnt_plain(n: int) -> tuple[Losses, dict[str, Tensor]]:
    taught = field()
    losses = SampleObjective(MAPPER, SMALL.truncation)(taught, rays(n), torch.Generator().manual_seed(1))
    losses.total.backward()
    return losses, gradients(taught)


@pytest.mark.parametrize("count", [1, 5000])  # more than a thread works off at a time
def test_traced_rays(count: int) -> None:
    """The same surface as plain steps find, ray by ray, also for rays that start at depths of their own; most of them meet some."""
    taught, generator = field(), torch.Generator().manual_seed(3)
    origins = 2 * torch.rand(count, 3, generator=generator) - 1
    directions = torch.randn(count, 3, generator=generator)
    near = 0.2 * torch.rand(count, generator=generator)
    limits = {"far": 2.0, "truncation": SMALL.truncation}
    for start in (near, 0.05):
        fast = compiled_field.trace(taught, origins, directions, near=start, **limits)
        plain = sphere_tracing.trace(taught.sdf, origins, directions, near=start, **limits)
        same = (fast - plain).abs() < 1e-4
        assert same.float().mean() > 0.995  # a ray that grazes a surface may pass it by the last bit
    assert count == 1 or (plain > 0).float().mean() > 0.5


def test_traced_rays_with_a_volume() -> None:
    """A fused plane at z = 1 hides the network's surfaces."""
    plane = plane_volume(1.0, range(-26, 26))
    surface = ImplicitSurface(field(), plane)
    origins, directions = torch.zeros(500, 3), 0.4 * torch.randn(500, 3, generator=torch.Generator().manual_seed(3))
    directions[:, 2] = 1
    limits = {"near": 0.97, "far": 1.2, "truncation": SMALL.truncation}
    fast, plain = surface.tracer()(origins, directions, **limits), sphere_tracing.trace(surface.sdf, origins, directions, **limits)
    torch.testing.assert_close(fast, plain, rtol=0, atol=1e-5)
    within = (directions[:, :2].abs() < 1.9).all(1)
    assert within.sum() > 400
    torch.testing.assert_close(fast[within], torch.ones(int(within.sum())), rtol=0, atol=2e-4)


# 5 samples near and 3 free a ray: 13 rays leave one block of 65 + 39 odd; 3 rays less than a block of each; 64 fill whole blocks alone
@pytest.mark.parametrize("n", [1, 3, 13, 64, 150])
def test_learning_is_that_of_autograd(n: int) -> None:
    (losses, found), (plain_losses, expected) = learnt_compiled(n), learnt_plain(n)
    for name in ("total", "photometric", "free_space", "truncation", "per_ray"):
        torch.testing.assert_close(getattr(losses, name), getattr(plain_losses, name).detach(), rtol=1e-4, atol=1e-5)
    assert set(found) == set(expected)
    assert len(found) == 1 + len(compiled_field.parameters(field()))
    for name, gradient in expected.items():
        largest = float(gradient.abs().max())
        assert largest > 0, name
        torch.testing.assert_close(found[name], gradient, rtol=1e-3, atol=1e-4 * largest, msg=lambda m, name=name: f"{name}: {m}")


def test_learning_adds_to_earlier_gradients() -> None:
    taught, objective = field(), SampleObjective(MAPPER, SMALL.truncation)
    for _ in range(2):
        objective.learn(taught, rays(20), torch.Generator().manual_seed(1))
    for name, once in learnt_compiled(20)[1].items():
        torch.testing.assert_close(gradients(taught)[name], 2 * once, rtol=1e-5, atol=1e-6)


def in_steps(n: int, steps: int, *, compiled: bool) -> tuple[list[Losses], MapOptimiser]:
    """Several steps of Adam on rays that each step has its share of, on points that do not depend on how they are drawn."""
    config = replace(MAPPER, samples=1, importance_samples=0, warm_up=2, learning_rate=0.003, table_rate=0.02)
    taught, generator = field(), torch.Generator().manual_seed(1)
    objective, optimiser = SampleObjective(config, SMALL.truncation), MapOptimiser(taught, config)
    assert compiled_field.learns_in_steps(taught, config)
    with optimiser.field.learning():
        if compiled:
            return objective.steps(taught, optimiser, rays(n * steps), steps, generator), optimiser
        losses = []
        for step in range(steps):
            optimiser.zero_grad()
            losses.append(objective.learn(taught, rays(n * steps).every(steps, step), generator))
            optimiser.step()
        return losses, optimiser


@pytest.mark.parametrize("n", [1, 13, 150])
def test_steps_at_once_are_steps_in_turns(n: int) -> None:
    (losses, found), (plain_losses, plain) = in_steps(n, 3, compiled=True), in_steps(n, 3, compiled=False)
    assert found.steps == plain.steps == 3
    for mine, other in zip(losses, plain_losses, strict=True):
        for name in ("total", "photometric", "truncation", "per_ray"):
            torch.testing.assert_close(getattr(mine, name), getattr(other, name), rtol=1e-3, atol=1e-5)
    for (name, mine), other in zip(found.field.state_dict().items(), plain.field.state_dict().values(), strict=True):
        torch.testing.assert_close(mine, other, rtol=1e-3, atol=2e-4, msg=lambda m, name=name: f"{name}: {m}")
    for mine, other in zip(found.networks, plain.networks, strict=True):
        for moment, value in plain.adam.state[other].items():
            largest = float(value.abs().max())
            torch.testing.assert_close(found.adam.state[mine][moment], value, rtol=1e-3, atol=1e-3 * largest)
    torch.testing.assert_close(found.m, plain.m, rtol=1e-3, atol=1e-6)
    assert not found.grid.gradient.any() and not found.grid.touched.any()


def test_many_samples_are_drawn_for_steps_at_once() -> None:
    taught = field()
    objective, optimiser = SampleObjective(MAPPER, SMALL.truncation), MapOptimiser(taught, MAPPER)
    first, *_, last = objective.steps(taught, optimiser, rays(60 * 40), 40, torch.Generator().manual_seed(1))
    assert len(first.per_ray) == 60 and float(last.truncation) < 0.6 * float(first.truncation)
    assert torch.isclose(first.total, first.per_ray.mean(), rtol=1e-5)


@pytest.mark.parametrize("changes", [{"gradient_clip": 1.0}, {"supervision": "rendering"}])
def test_other_ways_of_learning_are_taken_in_turns(changes: dict[str, float | str]) -> None:
    assert not compiled_field.learns_in_steps(field(), replace(MAPPER, **changes))


def test_learning_repeats_exactly() -> None:
    (losses, once), (losses_again, again) = learnt_compiled(150), learnt_compiled(150)
    assert torch.equal(losses.total, losses_again.total)
    assert all(torch.equal(once[name], again[name]) for name in once)


@pytest.mark.parametrize("n", [1, BLOCK - 1, BLOCK, 3 * BLOCK, 3 * BLOCK + 5])
def test_distance_and_sdf_are_those_of_the_field(n: int) -> None:
    asked, where = field(), points(n)
    value, gradient = compiled_field.distance_query(asked)(where)
    expected, expected_gradient = asked.distance(where)
    torch.testing.assert_close(value, expected, rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(gradient, expected_gradient, rtol=1e-3, atol=1e-3)
    with torch.no_grad():
        torch.testing.assert_close(compiled_field.sdf_function(asked)(where), asked.sdf(where), rtol=1e-4, atol=1e-5)
    assert all(p.grad is None for p in asked.parameters())


def test_queries_follow_the_weights() -> None:
    asked, where = field(), points(10)
    query = compiled_field.distance_query(asked)
    before = query(where)[0]
    with torch.no_grad():
        asked.sdf_head.bias += 1
    torch.testing.assert_close(query(where)[0], before + SMALL.truncation)  # T-SDF in units of the truncation


def test_queries_follow_tables_that_grew() -> None:
    asked, where = field(), points(100)
    query = compiled_field.distance_query(asked)
    before = query(where)[0]
    asked.encoding.double_tables()
    torch.testing.assert_close(query(where)[0], before)


@pytest.mark.parametrize(
    "changes", [{"layers": 2}, {"encoding": "positional"}, {"direction_frequencies": 2}, {"width": 18}, {"colour_width": 6}, {"levels": 3}]
)
def test_other_networks_take_the_plain_path(changes: dict[str, int | str]) -> None:
    other = Field(replace(SMALL, **changes))
    assert not compiled_field.compilable(other)
    where = points(7)
    assert torch.equal(compiled_field.distance_query(other)(where)[0], other.distance(where)[0])
