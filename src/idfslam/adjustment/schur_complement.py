"""Normal equations of a bundle adjustment, reduced to keyframes and camera by the Schur complement (Triggs et al., 2000).

A landmark is tied to nothing but keyframes and the camera, so its three unknowns are eliminated one landmark at a time. What is left is
sparse where few keyframes see the same landmarks.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import bmat, bsr_array, csc_array
from scipy.sparse.linalg import SuperLU, splu

from idfslam.adjustment.observations import Array, Observations
from idfslam.adjustment.residuals import Linearised


@dataclass(frozen=True)
class NormalEquations:
    """J^T W J and -J^T W r by blocks: keyframes (K, D), the camera's values and the errors of times (P,), landmarks (L, 3).

    A keyframe has D = 6 unknowns, those of its pose, or 12, with those of its velocity.
    """

    poses: Array  # (K, D, D): no image has a measurement in common with another
    values: Array  # (P, P)
    landmarks: Array  # (L, 3, 3)
    pose_values: Array  # (K, D, P)
    pose_landmark: bsr_array  # (D K, 3 L)
    values_landmarks: Array  # (P, 3 L)
    right_poses: Array  # (K, D)
    right_values: Array  # (P,)
    right_landmarks: Array  # (L, 3)
    between_poses: bsr_array | None = None  # (D K, D K) of relative poses; None: none is measured

    @staticmethod
    def of(at: Linearised, weights: Array, seen: Observations, keyframes: int, landmarks: int) -> "NormalEquations":
        """From residuals with weights (N, 3)."""
        by_keyframe, by_landmark = _Sums(seen.keyframe, keyframes), _Sums(seen.landmark, landmarks)
        A, B, C, r = at.by_pose, at.by_point, at.by_values, at.residuals
        wA, wB, wC = (J.transpose(0, 2, 1) * weights[:, None] for J in (A, B, C))
        order = np.lexsort((seen.landmark, seen.keyframe))
        starts = np.searchsorted(seen.keyframe[order], np.arange(keyframes + 1))
        blocks, shape = (wA @ B)[order], (A.shape[2] * keyframes, 3 * landmarks)
        return NormalEquations(
            by_keyframe(wA @ A),
            np.einsum("npi,niq->pq", wC, C),
            by_landmark(wB @ B),
            by_keyframe(wA @ C),
            bsr_array((blocks, seen.landmark[order], starts), shape=shape),
            by_landmark(wB @ C).transpose(2, 0, 1).reshape(C.shape[2], 3 * landmarks),
            -by_keyframe((wA @ r[:, :, None])[:, :, 0]),
            -np.einsum("npi,ni->p", wC, r),
            -by_landmark((wB @ r[:, :, None])[:, :, 0]),
        )


class ReducedSystem:
    """The system of keyframes and camera alone, factorised. `free` (D K + P,) says which unknowns are estimated.

    information (D K + P,): of each unknown at its present value, added to the diagonal. damping: share of it that is added to each
    diagonal, by Levenberg and Marquardt.
    """

    def __init__(self, n: NormalEquations, free: NDArray[np.bool_], information: Array, damping: float = 0.0) -> None:
        (K, D), P = n.right_poses.shape, len(n.values)
        self.equations, self._free = n, np.flatnonzero(free)
        V = n.landmarks + damping * np.eye(3) * n.landmarks
        self.landmark_covariances = np.linalg.inv(V)
        L = len(V)
        V_inverse = bsr_array((self.landmark_covariances, np.arange(L), np.arange(L + 1)), shape=(3 * L, 3 * L))
        W, Wc = n.pose_landmark, n.values_landmarks
        self._W_V = W @ V_inverse
        self._Wc_V = (self.landmark_covariances @ Wc.reshape(P, L, 3).transpose(1, 2, 0)).transpose(2, 0, 1).reshape(P, 3 * L)
        poses = bsr_array((n.poses, np.arange(K), np.arange(K + 1)), shape=(D * K, D * K)) - self._W_V @ W.T
        if n.between_poses is not None:
            poses = poses + n.between_poses
        cross = n.pose_values.reshape(D * K, P) - self._W_V @ Wc.T
        values = n.values - self._Wc_V @ Wc.T
        S = csc_array(bmat([[poses, cross], [cross.T, values]]))
        diagonal = np.concatenate([np.einsum("kii->ki", n.poses).ravel(), np.diagonal(n.values)])
        S = S + csc_array((damping * diagonal + information, (np.arange(len(diagonal)),) * 2), shape=S.shape)
        self._lu: SuperLU = splu(csc_array(S[self._free][:, self._free]), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
        self._size = D * K + P

    @property
    def entries(self) -> int:
        """How many numbers the factors have."""
        return int(self._lu.nnz)

    def solve(self, right: Array) -> tuple[Array, Array, Array]:
        """Increments of the keyframes (K, D), the values (P,) and the landmarks (L, 3). right (D K + P,) is added to the right side."""
        n, L = self.equations, len(self.landmark_covariances)
        b = n.right_landmarks.ravel()
        reduced = np.concatenate([n.right_poses.ravel() - self._W_V @ b, n.right_values - self._Wc_V @ b]) + right
        x = np.zeros(self._size)
        x[self._free] = self._lu.solve(reduced[self._free])
        poses, values = np.split(x, [n.right_poses.size])
        tied = (n.pose_landmark.T @ poses + n.values_landmarks.T @ values).reshape(L, 3)
        return poses.reshape(n.right_poses.shape), values, np.einsum("lij,lj->li", self.landmark_covariances, n.right_landmarks - tied)

    def covariance(self, unknowns: NDArray[np.int64]) -> Array:
        """(U, U) marginal covariance of some of the unknowns (D K + P); zero for those that are not estimated."""
        out = self.covariance_with(unknowns)[unknowns]
        return (out + out.T) / 2

    def covariance_with(self, unknowns: NDArray[np.int64]) -> Array:
        """(D K + P, U) covariance of all unknowns with some of them; zero for those that are not estimated."""
        places = np.searchsorted(self._free, unknowns).clip(max=max(len(self._free) - 1, 0))
        estimated = self._free[places] == unknowns
        right = np.zeros((len(self._free), int(estimated.sum())))
        right[places[estimated], np.arange(right.shape[1])] = 1
        out = np.zeros((self._size, len(unknowns)))
        out[np.ix_(self._free, np.flatnonzero(estimated))] = self._lu.solve(right)
        return out


class _Sums:
    """Sums rows by their group, in one fixed order."""

    def __init__(self, groups: NDArray[np.int64], count: int) -> None:
        self._order = np.argsort(groups, kind="stable")
        self._present, self._starts = np.unique(groups[self._order], return_index=True)
        self._count = count

    def __call__(self, rows: Array) -> Array:
        """(G, ...) of rows (N, ...)."""
        out = np.zeros((self._count, *rows.shape[1:]))
        out[self._present] = np.add.reduceat(rows[self._order], self._starts)
        return out
