"""The fast path of a small field on the CPU: whole network and losses in one Numba kernel; else plain torch, to the same values."""

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from idfslam.mapping.field import Field
from idfslam.mapping.grid import GridEncoding
from idfslam.mapping.kernels import grid_encode, grid_jacobian

if TYPE_CHECKING:
    from idfslam.mapping.objectives import Samples


def fusable(field: Field) -> bool:
    """Whether the kernels know this network: one hidden layer on a feature grid, colour of one more, all on the CPU in fp32."""
    c = field.config
    shape = c.encoding == "grid" and c.layers == 1 and c.direction_frequencies == 0
    fits = c.levels * c.features % 4 == 0 and c.width % 4 == 0 and c.colour_width % 4 == 0
    return shape and fits and not field.bf16 and next(field.parameters()).device.type == "cpu"


def weights(field: Field) -> list[NDArray[np.float32]]:
    """The network's parameters as the kernels take them, sharing memory."""
    return [p.detach().numpy() for p in parameters(field)]


def parameters(field: Field) -> list[nn.Parameter]:
    """The same as torch parameters, in the same order."""
    layers = [field.trunk[0], field.sdf_head, field.colour_head[0], field.colour_head[2]]
    return [p for layer in layers for p in layer.parameters()]


def distance_query(field: Field) -> Callable[[Tensor], tuple[Tensor, Tensor]]:
    """The fastest way to `Field.distance` of this field."""
    return (lambda points: distance(field, points)) if fusable(field) else field.distance


def distance(field: Field, points: Tensor) -> tuple[Tensor, Tensor]:
    """`Field.distance` for a fusable field."""
    from idfslam.mapping.kernels.numba_field import evaluate

    assert isinstance(field.encoding, GridEncoding)
    features, slopes = grid_jacobian(points, field.encoding.tables, field.encoding.cells)
    values, gradient = torch.empty(len(points)), torch.empty(len(points), 3)
    inputs, outputs = _arrays(features, slopes), _arrays(values, gradient)
    evaluate(*inputs, *weights(field)[:4], np.float32(field.config.truncation), *outputs)  # type: ignore[call-arg]
    return values, gradient


def sdf_function(field: Field) -> Callable[[Tensor], Tensor]:
    """The fastest way to `Field.sdf` without gradients."""
    return (lambda points: sdf(field, points)) if fusable(field) else field.sdf


def sdf(field: Field, points: Tensor) -> Tensor:
    """`Field.sdf` for a fusable field, without gradients."""
    from idfslam.mapping.kernels.numba_field import infer

    assert isinstance(field.encoding, GridEncoding)
    features = grid_encode(points.contiguous(), field.encoding.tables.detach(), field.encoding.cells)
    values = torch.empty(len(points))
    infer(features.numpy(), *weights(field)[:4], values.numpy())  # type: ignore[call-arg]
    return values


def learn(field: Field, samples: "Samples", free_margin: float) -> tuple[Tensor, Tensor]:
    """Squared terms (N,) and colour terms (near,) of the samples; the gradients of their weighted sum are added to the field's."""
    from idfslam.mapping.kernels import numba_field

    assert isinstance(field.encoding, GridEncoding)
    features = grid_encode(samples.points, field.encoding.tables.detach(), field.encoding.cells)
    g_features, terms, colour_terms = torch.empty_like(features), torch.empty(len(features)), torch.empty(samples.near)
    network = weights(field)
    g_network = [np.zeros((numba_field.PARTS, *w.shape), np.float32) for w in network]
    inputs = _arrays(samples.target, samples.weight), _arrays(samples.colour, samples.colour_weight)
    numba_field.learn(  # type: ignore[call-arg]
        features.numpy(), samples.near, *inputs[0], np.float32(free_margin), *inputs[1], *network,
        g_features.numpy(), *g_network, *_arrays(terms, colour_terms),
    )  # fmt: skip
    field.encoding.add_gradient(samples.points, g_features)
    for parameter, gradient in zip(parameters(field), g_network):
        total = torch.from_numpy(gradient.sum(0))
        parameter.grad = total if parameter.grad is None else parameter.grad + total
    return terms, colour_terms


def _arrays(*tensors: Tensor) -> list[NDArray[np.float32]]:
    return [t.numpy() for t in tensors]
