"""Covariances of adjusted poses, with what measurements share: noise is not all that residuals are made of.

The normal equations take each sighting for a draw of its own. But a patch that is not flat is off in all images alike, and blur, a shutter
or light that moves bend a part of an image as a whole. Both show in the residuals: those of one landmark, or of one part of an image, have
a common direction. With the sum g of their contributions to the normal equations, the poses' covariance is C M C, with M the sum of g g^T
(White, 1980; for two kinds of groups Cameron, Gelbach and Miller, 2011). It is added to C, that of the noise: residuals are smaller than
errors, since poses have followed them.
"""

import numpy as np
import torch
from scipy.sparse import csr_array

from idfslam.adjustment.bundle_adjustment import Adjusted, of_blocks, robust_weights
from idfslam.adjustment.observations import Array, Indices
from idfslam.adjustment.residuals import Linearised
from idfslam.adjustment.schur_complement import ReducedSystem

# Parts of an image's height and width. Of 2, 3, 4 on generated recordings 3 gave errors that were most alike to their covariances. More:
# what bends a larger part counts less
_PARTS = 3


class PoseCovariances:
    """Of each keyframe's pose."""

    def __init__(self, adjusted: Adjusted) -> None:
        problem, self._system, self._size = adjusted.problem, adjusted.system, adjusted.problem.unknowns
        at = problem.linearised()
        scores = _scores(at, problem.seen.keyframe, problem.seen.landmark, self._system)
        size = np.array([problem.model.camera.width, problem.model.camera.height])
        column, row = (problem.seen.uv / size * _PARTS).astype(np.int64).clip(0, _PARTS - 1).T
        part = (problem.seen.keyframe * _PARTS + row) * _PARTS + column
        lost = _PARTS**2 / (_PARTS**2 - 1)  # one of the parts of an image is taken up by its pose
        self._shared = _squares(scores, problem.seen.landmark) + lost * _squares(scores, part)
        if problem.edges is not None:
            poses = torch.from_numpy(problem.poses)
            self._shared = self._shared + problem.edges.squared_errors(poses).mean() / 6 * csr_array(
                of_blocks(problem.edges.normal_equations(poses)[0], problem.unknowns)
            )

    def of(self, keyframe: int) -> Array:
        """(6, 6) of xi, where T_wk exp(xi) is the true pose [m, rad]; zero for a fixed one."""
        own = self._size * keyframe + np.arange(6)
        by_all = self._system.covariance_with(own)[: self._shared.shape[0]]
        shared = by_all.T @ (self._shared @ by_all)
        return self._system.covariance(own) + (shared + shared.T) / 2


def _scores(at: Linearised, keyframe: Indices, landmark: Indices, system: ReducedSystem) -> csr_array:
    """(N, D K) what each sighting contributes to the right side of the reduced system."""
    n = system.equations
    off = robust_weights(at.residuals) * np.where(np.isfinite(at.residuals), at.residuals, 0.0)
    by_pose = np.einsum("nip,ni->np", at.by_pose, off)
    by_point = np.einsum("npq,nq->np", system.landmark_covariances[landmark], np.einsum("nip,ni->np", at.by_point, off))
    through_landmarks = _rows(by_point, landmark, len(n.landmarks)) @ csr_array(n.pose_landmark).T
    return csr_array(_rows(by_pose, keyframe, len(n.poses)) - through_landmarks)


def _rows(blocks: Array, places: Indices, count: int) -> csr_array:
    """(N, B count): each row has a block (B,) of blocks (N, B) at its place."""
    size = blocks.shape[1]
    columns = (size * places[:, None] + np.arange(size)).ravel()
    return csr_array((blocks.ravel(), columns, size * np.arange(len(blocks) + 1)), shape=(len(blocks), size * count))


def _squares(scores: csr_array, group: Indices) -> csr_array:
    """(D K, D K) the sum of g g^T over groups of rows, of which g is the sum."""
    rows = np.arange(len(group))
    sums = csr_array((np.ones(len(group)), (group, rows)), shape=(int(group.max(initial=-1)) + 1, len(group))) @ scores
    return csr_array(sums.T @ sums)
