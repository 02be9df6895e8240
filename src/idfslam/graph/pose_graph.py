"""The pose graph: keyframe poses that fit the measured edges between them, without wrong loops.

Sparse Gauss-Newton on SE(3). Before a loop is added all odometry edges have zero error, so the cost after optimisation is the loop's
squared Mahalanobis distance. If it exceeds the chi-square bound, the loops that contribute most are removed one by one. This is the second
test of a loop, after its verification by tracker and images.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.sparse import bsr_array
from scipy.sparse.linalg import spsolve
from torch import Tensor

from idfslam.geometry import se3

_CHI_SQUARE = 16.81  # 99 % bound of the chi-square distribution with six degrees of freedom; more: wrong loops stay, fewer right ones go
_SUSPECTS = 4  # loops that are left out one at a time to find the wrong one; more: a surer choice, at one optimisation each. Chosen by hand
_STEPS = 15  # Gauss-Newton steps at most; more: slower where it does not converge, and nothing else
_CONVERGED = 1e-7  # [m, rad] largest entry of a step that ends them; more: faster, less exact


@dataclass(frozen=True)
class Edge:
    """The measured relative pose of two keyframes."""

    a: int
    b: int
    T_ab: Tensor  # (4, 4) float64
    translation: float  # standard deviation [m] in each direction
    rotation: float  # [rad] about each axis
    loop: bool = False  # may be wrong


def optimise(poses: Sequence[Tensor], edges: Sequence[Edge]) -> tuple[list[Tensor], list[bool]]:
    """Optimises the poses T_wk (4, 4) with the first one fixed, without the loops that fail the chi-square test.

    The edges that are no loops must connect all poses. Returns the poses, and for each loop, in the order of the edges, whether it was
    kept.
    """
    graph, start = RelativePoses.of(edges), torch.stack(list(poses))
    loops = [i for i, edge in enumerate(edges) if edge.loop]
    kept = np.ones(len(edges), bool)
    T, cost = graph.solve(start, kept)
    while kept[loops].any() and cost > _CHI_SQUARE * kept[loops].sum():
        errors = graph.squared_errors(T)
        suspects = sorted((i for i in loops if kept[i]), key=lambda i: -errors[i])[:_SUSPECTS]
        solutions = [(graph.solve(start, without(kept, i)), i) for i in suspects]
        (T, cost), wrong = min(solutions, key=lambda solution: solution[0][1])
        kept[wrong] = False
    return list(T), kept[loops].tolist()


def without(kept: NDArray[np.bool_], i: int) -> NDArray[np.bool_]:
    """A copy of `kept` (E,) without edge i."""
    fewer = kept.copy()
    fewer[i] = False
    return fewer


@dataclass(frozen=True)
class RelativePoses:
    """Edges as tensors."""

    a: Tensor  # (E,)
    b: Tensor  # (E,)
    T_ba: Tensor  # (E, 4, 4) inverses of the measurements
    scale: Tensor  # (E, 6) inverse standard deviations

    @classmethod
    def of(cls, edges: Sequence[Edge]) -> "RelativePoses":
        """At least one edge."""
        a, b = torch.tensor([e.a for e in edges]), torch.tensor([e.b for e in edges])
        sigmas = torch.tensor([[e.translation] * 3 + [e.rotation] * 3 for e in edges], dtype=torch.float64)
        return cls(a, b, se3.inverse(torch.stack([e.T_ab for e in edges])), 1 / sigmas)

    def errors(self, T: Tensor) -> Tensor:
        """The errors (E, 6) of the measurements at poses (K, 4, 4), as logarithms."""
        return se3.log(self.T_ba @ se3.inverse(T[self.a]) @ T[self.b])

    def squared_errors(self, T: Tensor) -> NDArray[np.float64]:
        """The squared errors (E,) in units of the variances."""
        return (self.errors(T) * self.scale).square().sum(1).numpy()

    def solve(self, T: Tensor, kept: NDArray[np.bool_]) -> tuple[Tensor, float]:
        """Gauss-Newton from poses (K, 4, 4) with the edges `kept` (E,); returns the poses and the sum of the squared errors.

        Increments are in each pose's own frame.
        """
        root = torch.from_numpy(kept).to(T.dtype)
        for _ in range(_STEPS):
            step = self._step(T, root)
            T = torch.cat([T[:1], se3.orthonormal(T[1:] @ se3.exp(step))])
            if float(step.abs().max()) < _CONVERGED:
                break
        return T, float(self.squared_errors(T)[kept].sum())

    def _step(self, T: Tensor, root: Tensor) -> Tensor:
        """The increments (K - 1, 6) of all poses but the first."""
        H, b = self.normal_equations(T, root)
        return torch.from_numpy(spsolve(H.tocsc()[6:, 6:], b[1:].ravel())).view(-1, 6)

    def normal_equations(self, T: Tensor, root: Tensor | float = 1.0) -> tuple[bsr_array, NDArray[np.float64]]:
        """J^T J (6 K, 6 K) and -J^T e (K, 6) at poses (K, 4, 4), of errors e that count `root` (E,) times. Increments as of `solve`."""
        root = torch.as_tensor(root, dtype=T.dtype).expand(len(self.a))
        scale, e = self.scale * root[:, None], self.errors(T)
        turn = torch.eye(6, dtype=T.dtype) + 0.5 * adjoint_of_increment(e)  # inverse right Jacobian of the logarithm, to first order
        Jb = scale[:, :, None] * turn
        Ja = -Jb @ adjoint(se3.inverse(T[self.b]) @ T[self.a])
        count = len(T)
        blocks = torch.cat([Ja.mT @ Ja, Jb.mT @ Jb, Ja.mT @ Jb, Jb.mT @ Ja])
        rows, columns = torch.cat([self.a, self.b, self.a, self.b]), torch.cat([self.a, self.b, self.b, self.a])
        order = torch.argsort(rows, stable=True)
        starts = np.concatenate([[0], np.cumsum(np.bincount(rows.numpy(), minlength=count))])
        H = bsr_array((blocks[order].numpy(), columns[order].numpy(), starts), shape=(6 * count, 6 * count))
        g = torch.zeros(count, 6, dtype=T.dtype)
        for index, J in ((self.a, Ja), (self.b, Jb)):
            g.index_add_(0, index, (J.mT @ (scale * e)[..., None])[..., 0])
        return H, -g.numpy()


def adjoint(T: Tensor) -> Tensor:
    """The adjoint (..., 6, 6) of T (..., 4, 4): T exp(x) = exp(Ad x) T."""
    R, zero = T[..., :3, :3], torch.zeros_like(T[..., :3, :3])
    return torch.cat([torch.cat([R, se3.hat(T[..., :3, 3]) @ R], -1), torch.cat([zero, R], -1)], -2)


def adjoint_of_increment(xi: Tensor) -> Tensor:
    """The adjoint (..., 6, 6) of an increment (..., 6) in the Lie algebra: its Lie bracket with another one."""
    V, W = se3.hat(xi[..., :3]), se3.hat(xi[..., 3:])
    return torch.cat([torch.cat([W, V], -1), torch.cat([torch.zeros_like(W), W], -1)], -2)
