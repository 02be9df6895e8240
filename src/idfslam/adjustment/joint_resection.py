"""Joint resection: the poses of several images from points that they show, of which each has a place and a covariance.

The error of a point's place is the same in all images that show it. So the points are unknowns too, and are eliminated (Schur complement).
The poses before count as measurements: where few points are in view, they hold what these do not. How exact they are is told by how far the
points move them, as a variance component (Helmert): where a sensor does not reach, alignments are less exact than their covariances say.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from idfslam.adjustment.bundle_adjustment import exp
from idfslam.adjustment.camera_model import CameraModel
from idfslam.adjustment.observations import Array, Observations
from idfslam.adjustment.residuals import linearise
from idfslam.adjustment.schur_complement import NormalEquations, ReducedSystem
from idfslam.alignment.motion import change_between

# [standard deviations] Scale of the robust weights in each step. More: outliers count more; more steps: slower. Chosen by hand
_SCALES = 12.0, 4.0, 2.0, 2.0
# [1] Least and largest factor on the covariances of the poses before. The least: errors that images beside each other share do not show in
# how far points move them. More: better poses before count for less. The largest: more follows the points alone. Chosen by hand
_FACTOR = 0.5, 100.0
_LEAST_VARIANCE = 1e-12  # [m^2] of a point's place, in each direction. More: exact points count less


@dataclass(frozen=True)
class Images:
    """F images of a camera, and M points that they show."""

    model: CameraModel
    poses: Array  # (F, 4, 4) T_wc before
    covariances: Array  # (F, 6, 6) of these, of shift [m] and turn [rad] along the camera's axes
    points: Array  # (M, 3) [m] in the world
    point_covariances: Array  # (M, 3, 3) [m^2]
    seen: Observations  # `keyframe` is the image


def on_rays(model: CameraModel, uv: Array, z: Array, covariance: Array, z_sigma: Array) -> tuple[Array, Array]:
    """The points (N, 3) [m] at pixels (N, 2) and depths z (N,) [m], in the camera's frame, and their covariances (N, 3, 3) [m^2].

    covariance (N, 2, 2) [px^2] of uv. z_sigma (N,) [m].
    """
    rays, camera = model.rays(uv), model.camera
    across = z[:, None] / [camera.fx, camera.fy]
    covariances = rays[:, :, None] * rays[:, None] * (z_sigma**2)[:, None, None]
    covariances[:, :2, :2] += across[:, :, None] * across[:, None] * covariance
    return rays * z[:, None], covariances


def jointly_resected(groups: Sequence[Images]) -> list[Array]:
    """The poses T_wc (F, 4, 4) of groups of images that have one camera, by what each group shows, and by their poses before."""
    estimates, systems, factor = [_Estimate.of(images) for images in groups], list[ReducedSystem](), 1.0
    for scale in _SCALES:
        if systems:
            squared = sum(estimate.squared_changes for estimate in estimates)
            redundancy = sum(estimate.redundancy(system, factor) for estimate, system in zip(estimates, systems))
            factor = float(np.clip(squared / max(redundancy, 1e-9), *_FACTOR))
        steps = [estimate.step(scale, factor) for estimate in estimates]
        estimates, systems = [moved for moved, _ in steps], [system for _, system in steps]
    return [estimate.poses for estimate in estimates]


@dataclass(frozen=True)
class _Estimate:
    """The poses of images, and the places of the points that they show, after some steps."""

    images: Images
    information: Array  # (F, 6, 6) of the poses before
    point_information: Array  # (M, 3, 3)
    poses: Array
    points: Array

    @staticmethod
    def of(images: Images) -> "_Estimate":
        """As it is before."""
        of_points = np.linalg.inv(images.point_covariances + _LEAST_VARIANCE * np.eye(3)).astype(np.float64)
        return _Estimate(images, np.linalg.inv(images.covariances).astype(np.float64), of_points, images.poses, images.points)

    @property
    def changes(self) -> Array:
        """(F, 6) of the poses, along the cameras' axes before."""
        before, now = torch.from_numpy(self.images.poses), torch.from_numpy(self.poses)
        along_world = torch.stack([change_between(a, b) for a, b in zip(before, now)]).numpy().reshape(-1, 2, 3)
        return (along_world @ self.images.poses[:, :3, :3]).reshape(-1, 6)

    @property
    def squared_changes(self) -> float:
        """In standard deviations of the poses before, at their stated covariances."""
        return float(np.einsum("fi,fij,fj->", self.changes, self.information, self.changes))

    def redundancy(self, system: ReducedSystem, factor: float) -> float:
        """How much of the poses before the points tell too: their sum of squares if the factor on their covariances is right."""
        F = len(self.poses)
        covariances = system.covariance(np.arange(6 * F)).reshape(F, 6, F, 6)[np.arange(F), :, np.arange(F)]
        return 6 * F - float(np.einsum("fij,fji->", self.information, covariances)) / factor

    def step(self, scale: float, factor: float) -> tuple["_Estimate", ReducedSystem]:
        """A step of Gauss and Newton. scale: of the robust weights. factor: on the covariances of the poses before."""
        seen, F = self.images.seen, len(self.poses)
        at = linearise(self.images.model, self.poses, self.points, seen)
        weights = 1 / (1 + (at.residuals[:, :2] ** 2).sum(1) / scale**2) ** 2  # none of points behind the camera
        at = replace(at, residuals=np.where(np.isfinite(at.residuals), at.residuals, 0.0), by_values=at.by_values[:, :, :0])
        n = NormalEquations.of(at, np.repeat(weights[:, None], 3, 1), seen, F, len(self.points))
        n.poses[:] += self.information / factor
        n.right_poses[:] -= np.einsum("fij,fj->fi", self.information, self.changes) / factor
        n.landmarks[:] += self.point_information
        n.right_landmarks[:] -= np.einsum("mij,mj->mi", self.point_information, self.points - self.images.points)
        nothing = np.zeros(6 * F)
        system = ReducedSystem(n, np.ones(6 * F, bool), nothing)
        moves, _, shifts = system.solve(nothing)
        return replace(self, poses=self.poses @ exp(moves), points=self.points + shifts), system
