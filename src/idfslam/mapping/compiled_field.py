"""A small field on the CPU, compiled: network and losses in one Numba kernel. Plain torch gives the same values.

`compilable` says which fields these functions are for.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeGuard

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from idfslam.compute.backend import Backend, backend_of
from idfslam.config import MapperConfig
from idfslam.fusion.tsdf_volume import TsdfVolume, no_volume
from idfslam.mapping import sphere_tracing
from idfslam.mapping.field import Field
from idfslam.mapping.grid import GridEncoding
from idfslam.mapping.kernels import grid_encode
from idfslam.mapping.kernels.torch_grid import adam_rates
from idfslam.mapping.optimiser import MOMENTS, MapOptimiser
from idfslam.mapping.ray_samples import RaySamples
from idfslam.mapping.rays import Rays
from idfslam.mapping.surface_field import SurfaceField

_BETAS, _EPS = (0.9, 0.999), 1e-8  # torch's defaults for Adam: larger betas average over more steps


def compilable(field: SurfaceField) -> TypeGuard[Field]:
    """Whether the kernels support a field: one hidden layer on a feature grid, one more for colour, on the CPU in fp32."""
    if not isinstance(field, Field):
        return False
    c = field.config
    shape = c.encoding == "grid" and c.layers == 1 and c.direction_frequencies == 0
    fits = c.levels * c.features % 4 == 0 and c.width % 4 == 0 and c.colour_width % 4 == 0
    return shape and fits and not field.bf16 and backend_of(field.sdf_head.weight.device) is Backend.NUMBA


def weights(field: Field) -> tuple[NDArray[np.float32], ...]:
    """The network's parameters as arrays for the kernels, sharing memory."""
    return tuple(p.detach().numpy() for p in parameters(field))


def weights_of_distance(field: Field) -> tuple[NDArray[np.float32], ...]:
    """Those of them that the distance depends on: hidden layer and head."""
    return tuple(p.detach().numpy() for p in _of_layers(field.trunk[0], field.sdf_head))


def parameters(field: Field) -> list[nn.Parameter]:
    """The network's parameters in the order of the kernels."""
    return _of_layers(field.trunk[0], field.sdf_head, field.colour_head[0], field.colour_head[2])


def _of_layers(*layers: nn.Module) -> list[nn.Parameter]:
    """Weight and bias of linear layers. Torch's own search for parameters costs as much as the kernel that is given them."""
    return [p for layer in layers for p in (layer.weight, layer.bias)]  # type: ignore[misc]


def distance_query(field: SurfaceField) -> Callable[[Tensor], tuple[Tensor, Tensor]]:
    """`distance` of this field, compiled if possible."""
    return lambda points: distance(field, points) if compilable(field) else field.distance(points)


def distance(field: Field, points: Tensor) -> tuple[Tensor, Tensor]:
    """`Field.distance` for a compilable field."""
    from idfslam.mapping.kernels import numba_field

    values, gradient = torch.empty(len(points)), torch.empty(len(points), 3)
    scale = np.float32(field.config.truncation)
    numba_field.distance(points.contiguous().numpy(), _grid(field), weights_of_distance(field), scale, *_arrays(values, gradient))  # type: ignore[call-arg]
    return values, gradient


def _grid(field: Field) -> tuple[NDArray[np.float32], NDArray[np.float32], tuple[int, ...]]:
    """The tables, the number of cells per metre of each level, and a tuple of zeros as long as an entry has features."""
    grid = field.encoding
    assert isinstance(grid, GridEncoding)
    tables = grid.tables.detach().numpy()
    return tables, np.float32(1) / grid.cells.numpy(), (0,) * tables.shape[2]


def sdf_function(field: SurfaceField) -> Callable[[Tensor], Tensor]:
    """`sdf` of this field without gradients, compiled if possible."""
    return lambda points: sdf(field, points) if compilable(field) else field.sdf(points)


def sdf(field: Field, points: Tensor) -> Tensor:
    """`Field.sdf` for a compilable field, without gradients."""
    from idfslam.mapping.kernels.numba_field import infer

    assert isinstance(field.encoding, GridEncoding)
    features = grid_encode(points.contiguous(), field.encoding.tables.detach(), field.encoding.cells)
    values = torch.empty(len(points))
    infer(features.numpy(), *weights_of_distance(field), values.numpy())  # type: ignore[call-arg]
    return values


def trace(
    field: Field,
    origins: Tensor,
    directions: Tensor,
    *,
    near: float | Tensor,
    far: float,
    truncation: float,
    volume: TsdfVolume | None = None,
) -> Tensor:
    """`sphere_tracing.trace` for a compilable field, with which a volume is blended."""
    from idfslam.mapping.kernels import numba_tracing

    assert isinstance(field.encoding, GridEncoding)
    starts = torch.as_tensor(near, dtype=torch.float32).expand(len(origins)).contiguous()
    depth, reach = torch.zeros(len(origins)), truncation / directions.norm(dim=-1)
    rays = _arrays(origins.contiguous(), directions.contiguous(), starts, reach)
    limits = np.float32(far), np.float32(sphere_tracing.CAUTION), np.float32(sphere_tracing.LEAST_STEP)
    blocks = tuple((volume or no_volume()).arrays)
    numba_tracing.trace(rays, limits, _grid(field), weights_of_distance(field), truncation, blocks, depth.numpy())  # type: ignore[call-arg]
    return depth


def learn(field: Field, samples: RaySamples, free_margin: float) -> tuple[Tensor, Tensor]:
    """Adds the gradients of the samples' loss to the field's; returns its terms, of the T-SDF (N,) and of colour (near,)."""
    from idfslam.mapping.kernels import numba_field

    assert isinstance(field.encoding, GridEncoding)
    features = grid_encode(samples.points, field.encoding.tables.detach(), field.encoding.cells)
    g_features, terms, colour_terms = torch.empty_like(features), torch.empty(len(features)), torch.empty(samples.near)
    network = weights(field)
    g_network = _separate_sums(network)
    distances = *_arrays(samples.target, samples.weight), np.float32(free_margin)
    targets = samples.near, distances, _arrays(samples.colour, samples.colour_weight)
    numba_field.learn(features.numpy(), *targets, network, g_features.numpy(), g_network, _arrays(terms, colour_terms))  # type: ignore[call-arg]
    field.encoding.add_gradient(samples.points, g_features)
    for parameter, gradient in zip(parameters(field), g_network):
        total = torch.from_numpy(gradient.sum(0))
        parameter.grad = total if parameter.grad is None else parameter.grad + total
    return terms, colour_terms


@dataclass(frozen=True)
class Learnt:
    """The terms of the loss at each step."""

    terms: Tensor  # (steps, N) of the T-SDF, weighted; the first `near` are near the surface, the rest in free space
    colour_terms: Tensor  # (steps, near) of colour
    near: int


def learns_in_steps(field: Field, config: MapperConfig) -> bool:
    """Whether `learn_steps` supports this field and config."""
    return config.supervision == "samples" and not config.gradient_clip and compilable(field)


def learn_steps(field: Field, optimiser: MapOptimiser, rays: Rays, steps: int, config: MapperConfig, generator: torch.Generator) -> Learnt:
    """`steps` steps of Adam, step i on every `steps`-th ray from i on: as `SampleObjective.learn` and `MapOptimiser.step` in turn.

    Each part of a step is one call of a kernel that releases the interpreter's lock. In torch a step has about fifty more operations, and
    the thread that tracks frames can take the lock at each of them.
    """
    from idfslam.mapping.kernels import numba_field, numba_grid, numba_rays

    assert isinstance(field.encoding, GridEncoding)
    grid, c, count = field.encoding, config, len(rays) // steps
    rays = rays.in_turns(steps)
    jitter, free_jitter = (torch.rand(len(rays), number, generator=generator).numpy() for number in (c.samples, c.importance_samples))
    along = [t.numpy() for t in (rays.origins.contiguous(), rays.directions, rays.depth, rays.cos_incidence)]
    near, free = count * c.samples, count * c.importance_samples
    colour = rays.colour.repeat_interleave(c.samples, 0).numpy()
    colour_weight = np.full(near, c.photometric_weight / near, np.float32)
    weight = np.full(near + free, c.free_space_weight / max(free, 1), np.float32)
    weight[:near] = c.truncation_weight / near
    points, target = np.empty((near + free, 3), np.float32), np.empty(near + free, np.float32)
    features = np.empty((near + free, grid.out_dim), np.float32)
    g_features, terms = np.empty_like(features), np.empty((steps, near + free), np.float32)
    colour_terms = np.empty((steps, near), np.float32)
    network = weights(field)
    g_network = _separate_sums(network)
    distances = target, weight, np.float32(c.free_margin)
    moments = [[optimiser.adam.state[p][name].numpy().reshape(-1) for name in MOMENTS] for p in parameters(field)]
    tables = numba_grid.Tables(grid.tables, grid.gradient, optimiser.m, optimiser.v, grid.touched, grid.cells)
    for step in range(steps):
        turn = slice(step * count, (step + 1) * count)
        drawn = [t[turn] for t in along]
        numba_rays.place(*drawn, jitter[turn], free_jitter[turn], np.float32(field.config.truncation), points, target)  # type: ignore[call-arg]
        tables.forward(points, features)
        colours = colour[step * near : (step + 1) * near], colour_weight
        numba_field.learn(features, near, distances, colours, network, g_features, g_network, (terms[step], colour_terms[step]))  # type: ignore[call-arg]
        tables.backward(points, g_features)
        rate, table_rate = optimiser.advance()
        rates = numba_grid.single(adam_rates(rate, *_BETAS, _EPS, optimiser.steps))
        for w, g, (m, v) in zip(network, g_network, moments):
            numba_field.adam(w.reshape(-1), g.reshape(len(g), -1), m, v, *rates)  # type: ignore[call-arg]
        tables.adam(table_rate, optimiser.steps)
    for p in parameters(field):
        optimiser.adam.state[p]["step"] += steps
    torch.autograd.graph.increment_version([*parameters(field), grid.tables])
    return Learnt(torch.from_numpy(terms), torch.from_numpy(colour_terms), near)


def _separate_sums(network: Sequence[NDArray[np.float32]]) -> tuple[NDArray[np.float32], ...]:
    """Gradients of the network's parameters for the kernels, as separate sums, at zero."""
    from idfslam.mapping.kernels.numba_field import PARTS

    return tuple(np.zeros((PARTS, *w.shape), np.float32) for w in network)


def _arrays(*tensors: Tensor) -> tuple[NDArray[np.float32], ...]:
    return tuple(t.numpy() for t in tensors)
