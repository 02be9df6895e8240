"""Gauss-Newton steps of the alignment: of a pose alone, or of a pose and a velocity together."""

from typing import Protocol

import numpy as np
import torch
from torch import Tensor

from idfslam.alignment.continuous_motion import JointEstimate, MotionPrior
from idfslam.alignment.depth_term import DepthTerm
from idfslam.alignment.frame_motion import FrameMotion
from idfslam.alignment.joint_equations import joint_system, with_reference_error
from idfslam.alignment.motion import Information, change_between, moved
from idfslam.alignment.row_moments import Array, PoseEquations, RowMoments
from idfslam.compute.backend import pick
from idfslam.sensing.rectification import RowTimes

# [1] Share of the points and landmarks that err independently: neighbours share the errors of the map. More: velocities follow the
# images more, and the prior of the motion less. Chosen by hand on generated hand-held recordings.
INDEPENDENT = 0.02


def information_scale(depth_noise: float) -> float:
    """[1/m^2] the factor from sums in units of depth to information: depth_noise [m], and the share that errs independently."""
    return INDEPENDENT / depth_noise**2


class Solver(Protocol):
    """Takes steps from the terms at the present pose and velocity."""

    @property
    def motion(self) -> FrameMotion | None:
        """The present motion within the frame; None: all its rows have one time."""
        ...

    def step(self, depth: DepthTerm, images: PoseEquations) -> Array:
        """Moves the pose; returns its change (6,)."""
        ...

    def estimate(self, depth: DepthTerm, images: PoseEquations) -> JointEstimate | None:
        """The velocity at the present pose, if it is estimated too."""
        ...


class PoseSolver:
    """Gauss-Newton steps of a pose T (4, 4), which is moved in place. Directions with little information keep the guess."""

    def __init__(self, T: Tensor, prior_information: float) -> None:
        self.T, self.prior_information, self.change = T, prior_information, torch.zeros(6, dtype=torch.float64)

    @property
    def motion(self) -> None:
        """None: all rows of the frame have one time."""

    def step(self, depth: DepthTerm, images: PoseEquations) -> Array:
        sums, before = depth.sums + images.sums, self.change.numpy().copy()
        H, b = torch.from_numpy(sums.H[0]), torch.from_numpy(sums.b[0])
        damped_step(H, b, depth.weight, depth.radius, self.prior_information, self.change, self.T)
        return np.asarray(self.change.numpy() - before)

    def estimate(self, depth: DepthTerm, images: PoseEquations) -> None:
        """None: the velocity is not estimated."""


class JointSolver:
    """Gauss-Newton steps of a pose T (4, 4), moved in place, and of the velocity, with a prior for both.

    The error of the references' velocities is one more unknown. It acts on residuals as the velocity does.
    """

    def __init__(self, T: Tensor, prior: MotionPrior, times: RowTimes, depth_noise: float) -> None:
        self.T, self.prior, self.times = T, prior, times
        self._information = prior.with_reference_error
        self.velocity, self.reference_error = prior.velocity.copy(), np.zeros(6)
        self.scale = information_scale(depth_noise)

    @property
    def motion(self) -> FrameMotion:
        """The present velocity, and the rows' times."""
        return FrameMotion(self.times, self.velocity)

    def step(self, depth: DepthTerm, images: PoseEquations) -> Array:
        from_prior = [change_between(self.prior.T_wc, self.T).numpy(), self.velocity - self.prior.velocity, self.reference_error]
        delta = joint_step(depth.sums, images.sums, self.times, self._information, self.scale, np.concatenate(from_prior))
        self.T[:] = moved(self.T, torch.from_numpy(delta[:6]))
        self.velocity, self.reference_error = self.velocity + delta[6:12], self.reference_error + delta[12:]
        return np.asarray(delta[:6])

    def estimate(self, depth: DepthTerm, images: PoseEquations) -> JointEstimate:
        """The velocity, and the covariance of pose and velocity."""
        H, _ = with_reference_error(*joint_system(depth.sums, images.sums, self.times))
        covariance = np.linalg.inv(self.scale * H + self._information)[:12, :12]
        return JointEstimate(self.velocity, np.asarray(covariance, np.float64))


def joint_step(depth: RowMoments, images: RowMoments, times: RowTimes, information: Array, scale: float, from_prior: Array) -> Array:
    """(18,) the change of pose, velocity and the references' error of velocity.

    information (18, 18): of the prior, from which these are `from_prior` (18,) away. scale: of the sums, in units of information.
    """
    return pick(torch.empty(0), compiled=compiled_joint_step, plain=plain_joint_step)(depth, images, times, information, scale, from_prior)


def compiled_joint_step(
    depth: RowMoments, images: RowMoments, times: RowTimes, information: Array, scale: float, from_prior: Array
) -> Array:
    """`joint_step` by Numba."""
    from idfslam.alignment.kernels import numba_gauss_newton

    delta = np.empty(18)
    numba_gauss_newton.joint_step(depth.H, depth.b, images.H, images.b, times.array, information, scale, from_prior, delta)  # type: ignore[call-arg]
    return delta


def plain_joint_step(depth: RowMoments, images: RowMoments, times: RowTimes, information: Array, scale: float, from_prior: Array) -> Array:
    """`joint_step` in numpy."""
    H, b = with_reference_error(*joint_system(depth, images, times))
    right = scale * (b - H[:, 12:] @ from_prior[12:]) - information @ from_prior
    return np.asarray(np.linalg.solve(scale * H + information, right))


def damped_step(H: Tensor, b: Tensor, weight: float, radius: float, prior_information: float, change: Tensor, T: Tensor) -> float:
    """A Gauss-Newton step of normal equations H (6, 6), b (6,), with a prior at the guess for directions with little information.

    prior_information: information [1] below which the prior dominates (`Information.prior`). The step moves in place the pose T (4, 4) and
    its change since the guess, change (6,). Returns the largest entry of the step. All tensors are on the host, wherever the points are.
    """
    return pick(H, compiled=compiled_damped_step, plain=plain_damped_step)(H, b, weight, radius, prior_information, change, T)


def compiled_damped_step(H: Tensor, b: Tensor, weight: float, radius: float, prior_information: float, change: Tensor, T: Tensor) -> float:
    """`damped_step` by Numba, on the CPU."""
    from idfslam.alignment.kernels import numba_gauss_newton

    return float(numba_gauss_newton.damped_step(H.numpy(), b.numpy(), weight, radius, prior_information, change.numpy(), T.numpy()))  # type: ignore[call-arg]


def plain_damped_step(H: Tensor, b: Tensor, weight: float, radius: float, prior_information: float, change: Tensor, T: Tensor) -> float:
    """`damped_step` in torch, on any device."""
    P = Information.of(H, weight, radius).prior(prior_information)
    delta = torch.linalg.solve(H + P, b - P @ change)
    change += delta
    T[:] = moved(T, delta)
    return float(delta.abs().max())
