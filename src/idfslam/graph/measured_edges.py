"""Edges between keyframes whose relative pose was measured, with the standard deviations that tracking gives them.

Loops have others (`loop_consistency`): they come from one alignment, whatever the path between their keyframes.
"""

import torch
from torch import Tensor

from idfslam.geometry import se3
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.graph.path_length import edge_pairs
from idfslam.graph.pose_graph import Edge

# Standard deviation of an edge: [m] and [m per m], [rad] and [rad per rad]. More: loops bend the graph more, and fewer fail the chi-square
# test. Chosen by hand.
_SIGMA = (0.01, 0.02), (0.004, 0.02)


def measured_edges(graph: KeyframeGraph, factor: float = 1.0) -> list[Edge]:
    """The edges between stored keyframes, at the present poses. factor: on their standard deviations."""
    a, b = edge_pairs(graph.keyframes)
    T = torch.stack([keyframe.T_wk for keyframe in graph.keyframes])
    T_ab = se3.inverse(T[a]) @ T[b]
    return [Edge(*edge) for edge in zip(a.tolist(), b.tolist(), T_ab, *(sigma.tolist() for sigma in _sigmas(T_ab, factor)))]


def measured_edge(a: int, b: int, T_ab: Tensor, factor: float = 1.0) -> Edge:
    """The edge between two keyframes whose measured relative pose is T_ab (4, 4). factor: on its standard deviations."""
    translation, rotation = _sigmas(T_ab, factor)
    return Edge(a, b, T_ab, float(translation), float(rotation))


def _sigmas(T_ab: Tensor, factor: float) -> tuple[Tensor, Tensor]:
    """The standard deviations (...) [m], [rad] of edges T_ab (..., 4, 4)."""
    (shift, shift_per_m), (turn, turn_per_rad) = _SIGMA
    translation = factor * (shift + shift_per_m * T_ab[..., :3, 3].norm(dim=-1))
    return translation, factor * (turn + turn_per_rad * se3.angle(T_ab))
