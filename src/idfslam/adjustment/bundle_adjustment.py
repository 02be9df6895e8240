"""Bundle adjustment: keyframe poses, landmarks and the camera that fit all measurements best, together, and how sure they are.

Relative poses that were measured by other means hold what landmarks do not: a keyframe before a bare wall.

Levenberg-Marquardt with robust weights (Huber, by iterated reweighting). The noise of images and of depth is estimated with the rest, as
variance components: squared residuals over their redundancy. Measurements that fit badly are left out. Nothing depends on chance or order.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from time import perf_counter

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.sparse import bsr_array

from idfslam.adjustment.camera_model import NAMES, PRIORS, CameraModel
from idfslam.adjustment.observations import Array, Indices, Observations, determined
from idfslam.adjustment.residuals import Linearised, camera_points, linearise
from idfslam.adjustment.row_motion import KeyframeMotion, TimeErrors, Velocities, row_motion, with_inexact_times
from idfslam.adjustment.schur_complement import NormalEquations, ReducedSystem
from idfslam.geometry import se3
from idfslam.graph.pose_graph import RelativePoses

_HUBER = 2.5  # [standard deviations] from which on a measurement counts for less; raised, outliers count more. Of a normal distribution 1 %
#    is beyond, which is 4 % of the image's points
_OUTLIER = 4.0  # [standard deviations] beyond which a measurement is left out; raised, more outliers stay, at the weight of a 2.5 to 4
_ROUNDS = 4  # of adjustment, estimation of the noise and removal of outliers; more: slower, noise that is guessed wrongly is mended better
_STEPS = 12  # most steps of a round; more: slower where it does not converge
_CONVERGED = 1e-5  # [1] relative change of the cost that ends a round; more: faster, less exact
_DAMPING = 1e-4, 1e-9, 1e6  # [1] Marquardt's damping at first, at least and at most; more: shorter steps
_POSE_INFORMATION = 1.0  # [1/m^2, 1/rad^2] of a pose at its present value, so that one that nothing determines stays; more: shorter steps
KINDS = "image", "depth", "distant"
"""Measurements whose noise is estimated apart: places in images, readings of depth, and places of landmarks without depth."""
_LEAST_NOISE = 0.05  # [1] least factor on the stated noise; more: exact measurements count less. Chosen by hand


@dataclass(frozen=True)
class Problem:
    """K keyframes, L landmarks, one camera, and what was measured."""

    model: CameraModel
    poses: Array  # (K, 4, 4) T_wk
    points: Array  # (L, 3) [m] in the world
    seen: Observations
    fixed: NDArray[np.bool_]  # (K,) poses that stay: at least one of each group of keyframes that nothing connects
    estimated: NDArray[np.bool_]  # (P,) values of the camera that are estimated
    edges: RelativePoses | None = None  # relative poses that were measured by other means
    velocities: Velocities | None = None  # of all keyframes, where the rows of an image have times of their own
    times: TimeErrors = field(default_factory=TimeErrors.none)  # of the sensors, where there are velocities

    @property
    def unknowns(self) -> int:
        """How many unknowns a keyframe has: D."""
        return 6 if self.velocities is None else 12

    @property
    def shared(self) -> Indices:
        """(S,) the places, among values and times (P + T,), of those that are estimated. All keyframes share them."""
        return np.concatenate([np.flatnonzero(self.estimated), len(self.estimated) + np.arange(len(self.times.present))])

    @property
    def free(self) -> NDArray[np.bool_]:
        """(D K + S,) the unknowns of keyframes that are estimated, and all of `shared`. A fixed pose may have a velocity that is not."""
        of_keyframes = np.ones((len(self.poses), self.unknowns), bool)
        of_keyframes[self.fixed, :6] = False
        return np.concatenate([of_keyframes.ravel(), np.ones(len(self.shared), bool)])

    def linearised(self) -> Linearised:
        """The residuals at the present values, with derivatives."""
        velocities = None if self.velocities is None else self.velocities.present
        return linearise(self.model, self.poses, self.points, self.seen, velocities, self.times.present)


@dataclass(frozen=True)
class Adjusted:
    """The solution of a problem, with its noise, and the system that it solves."""

    problem: Problem  # with the solution and the measurements that were kept, at their estimated noise
    system: ReducedSystem
    noise: tuple[float, float, float]  # [1] factors that were found on the stated noise, by kind of measurement
    complete: bool  # False: the time was over before it converged

    def values_covariance(self) -> Array:
        """(P, P) of the camera's values; zero for those that were not estimated."""
        first, estimated = self.problem.unknowns * len(self.problem.poses), self.problem.estimated
        out = np.zeros((len(NAMES), len(NAMES)))
        out[np.ix_(estimated, estimated)] = self.system.covariance(first + np.arange(estimated.sum()))
        return out

    def pose_covariance(self, keyframe: int) -> Array:
        """(6, 6) of xi, where T_wk exp(xi) is the true pose [m, rad]; zero for a fixed one."""
        return self.system.covariance(self.problem.unknowns * keyframe + np.arange(6))


def in_motion(
    problem: Problem, motions: Sequence[KeyframeMotion], recordings: NDArray[np.int64] | None = None, sigmas: Array | None = None
) -> Problem:
    """A problem whose K keyframes moved so while their images were taken: the problem itself if all rows are of one moment.

    recordings: (K,) numbers of the recordings that the keyframes are of; None: there is one. sigmas: (R, 3) [s] standard deviations of the
    read-out times of colour and depth, and of depth's delay, of each recording; None: they are exact.
    """
    of = np.zeros(len(motions), np.int64) if recordings is None else recordings
    sigmas = np.zeros((int(of.max(initial=0)) + 1, 3)) if sigmas is None else sigmas
    if all(motion.synchronised for motion in motions) and not sigmas.any():
        return problem
    seen, z = problem.seen, camera_points(problem.poses, problem.points, problem.seen)[:, 2:]
    points = problem.model.rays(seen.uv) * z
    rows = with_inexact_times(row_motion(points, seen.keyframe, motions, problem.model.camera), of[seen.keyframe], sigmas)
    return replace(problem, seen=replace(seen, rows=rows), velocities=Velocities.of(motions), times=TimeErrors.of(sigmas))


def adjust(problem: Problem, *, seconds: float = np.inf) -> Adjusted:
    """Adjusts everything that is free. After `seconds` no further step begins: then, and only then, the clock decides about the result."""
    end, noise = perf_counter() + seconds, np.ones(len(KINDS))
    points, seen = determined(problem.points, problem.seen)
    problem = replace(problem, points=points, seen=seen)
    for last in [False] * (_ROUNDS - 1) + [True]:
        problem, converged = _minimised(problem, end, _STEPS)
        at = problem.linearised()
        late = perf_counter() > end
        if last or late:
            break
        factors = np.maximum(_noise_factors(at, problem), _LEAST_NOISE / noise)
        noise *= factors
        problem = without_outliers(_with_noise(problem, factors), at.residuals / factors[_kinds(problem.seen)])
    system = ReducedSystem(_equations(at, problem), problem.free, _information(problem))
    return Adjusted(problem, system, (float(noise[0]), float(noise[1]), float(noise[2])), converged and not late)


def adjust_briefly(problem: Problem, *, noise: Array, steps: int) -> tuple[Problem, Array]:
    """At most `steps` steps of a problem that is nearly solved, with noise that is `noise` (3,) times the stated one, by kind.

    Outliers stay, at less weight. Returns the problem, with the noise that is found, and the factors (3,) of that on the stated one.
    """
    problem, _ = _minimised(_with_noise(problem, noise), np.inf, steps)
    at = problem.linearised()
    factors = np.maximum(_noise_factors(at, problem), _LEAST_NOISE / noise)
    return _with_noise(problem, factors), noise * factors


def without_outliers(problem: Problem, off: Array) -> Problem:
    """Without the measurements whose residuals (N, 3) are too large, and without landmarks that fewer than two keyframes see then."""
    seen = problem.seen
    seen = replace(seen, reading=np.where(np.abs(off[:, 2]) < _OUTLIER, seen.reading, 0.0))
    seen = seen[np.linalg.norm(off[:, :2], axis=1) < _OUTLIER]
    points, seen = determined(problem.points, seen)
    return replace(problem, points=points, seen=seen)


def _minimised(problem: Problem, end: float, steps: int) -> tuple[Problem, bool]:
    """The problem at the least cost, and whether it converged."""
    damping, at = _DAMPING[0], problem.linearised()
    cost = _cost(at, problem)
    for _ in range(steps):
        n = _equations(at, problem)
        while damping <= _DAMPING[2]:
            if perf_counter() > end:
                return problem, False
            moved = _moved(problem, n, damping)
            there = moved.linearised()
            if (new := _cost(there, moved)) <= cost:
                break
            damping *= 10
        else:
            return problem, True
        decrease, problem, at, cost = cost - new, moved, there, new
        damping = max(damping / 10, _DAMPING[1])
        if decrease <= _CONVERGED * cost:
            return problem, True
    return problem, False


def _moved(problem: Problem, n: NormalEquations, damping: float) -> Problem:
    """The problem after one step."""
    of_keyframes, shared = np.zeros(problem.unknowns * len(problem.poses)), np.concatenate([problem.model.values, problem.times.present])
    drawn = np.concatenate([of_keyframes, (-_shared_information(problem) * shared)[problem.shared]])
    steps = np.zeros(len(shared))
    keyframes, steps[problem.shared], points = ReducedSystem(n, problem.free, _information(problem), damping).solve(drawn)
    values, late = np.split(steps, [len(NAMES)])
    model, v = replace(problem.model, values=problem.model.values + values), problem.velocities
    return replace(
        problem,
        model=model,
        poses=problem.poses @ exp(keyframes[:, :6]),
        points=problem.points + points,
        velocities=None if v is None else replace(v, present=v.present + keyframes[:, 6:]),
        times=replace(problem.times, present=problem.times.present + late),
    )


def _value_information() -> Array:
    return np.array(list(PRIORS.values())) ** -2


def _shared_information(problem: Problem) -> Array:
    """(P + T,) of the priors of what all keyframes share."""
    return np.concatenate([_value_information(), problem.times.information])


def _information(problem: Problem) -> Array:
    of_keyframes = np.zeros((len(problem.poses), problem.unknowns))
    of_keyframes[:, :6] = _POSE_INFORMATION
    return np.concatenate([of_keyframes.ravel(), _shared_information(problem)[problem.shared]])


def _equations(at: Linearised, problem: Problem) -> NormalEquations:
    weights = robust_weights(at.residuals)
    residuals = np.where(np.isfinite(at.residuals), at.residuals, 0.0)
    finite = replace(at, residuals=residuals, by_values=at.by_values[:, :, problem.shared])
    n = NormalEquations.of(finite, weights, problem.seen, len(problem.poses), len(problem.points))
    if problem.velocities is not None:
        n.poses[:, 6:, 6:] += problem.velocities.information
        n.right_poses[:, 6:] += problem.velocities.right
    if problem.edges is None:
        return n
    between, right = problem.edges.normal_equations(torch.from_numpy(problem.poses))
    n.right_poses[:, :6] += right
    return replace(n, between_poses=of_blocks(between, problem.unknowns))


def of_blocks(H: bsr_array, size: int) -> bsr_array:
    """A matrix of blocks (6, 6) with blocks (size, size) that begin with them, and zeros."""
    if size == 6:
        return H
    blocks = np.zeros((len(H.data), size, size))
    blocks[:, :6, :6] = H.data
    return bsr_array((blocks, H.indices, H.indptr), shape=tuple(n // 6 * size for n in H.shape))


def _sizes(off: Array) -> Array:
    """(N, 2) how far off image and depth are [standard deviations], of residuals (N, 3)."""
    return np.stack([np.linalg.norm(off[:, :2], axis=1), np.abs(off[:, 2])], 1)


def robust_weights(off: Array) -> Array:
    """(N, 3) Huber's weights of residuals (N, 3), by image and depth; 0 for points behind the camera."""
    size = _sizes(off)
    return np.where(np.isfinite(size), _HUBER / np.maximum(size, _HUBER), 0.0)[:, [0, 0, 1]]


def _cost(at: Linearised, problem: Problem) -> float:
    """Huber's cost of the residuals, and the cost of the camera's deviations and of the relative poses."""
    size = _sizes(at.residuals)
    capped = np.minimum(size, _HUBER)
    finite = np.where(np.isfinite(size), capped * (2 * size - capped), 1e12)  # a point behind the camera: no step may lead there
    off = 0.0 if problem.edges is None else problem.edges.squared_errors(torch.from_numpy(problem.poses)).sum()
    off += 0.0 if problem.velocities is None else problem.velocities.cost + problem.times.cost
    return float(finite.sum() + (_value_information() * problem.model.values**2).sum() + off)


def _kinds(seen: Observations) -> Indices:
    """(N, 3) the kind, of KINDS, of each residual of each observation."""
    of_image = np.where(seen.distant, KINDS.index("distant"), KINDS.index("image"))
    return np.stack([of_image, of_image, np.full(len(seen), KINDS.index("depth"))], 1)


def _noise_factors(at: Linearised, problem: Problem) -> Array:
    """(3,) by kind, the factors on the stated noise: sqrt of squared residuals over redundancy (Helmert's variance components).

    The redundancy of a measurement is what its landmark does not take up.
    """
    weights = robust_weights(at.residuals) * np.stack([np.ones(len(problem.seen))] * 2 + [problem.seen.reading > 0], 1)
    V = np.zeros((len(problem.points), 3, 3))
    np.add.at(V, problem.seen.landmark, at.by_point.transpose(0, 2, 1) * weights[:, None] @ at.by_point)
    inverse = np.linalg.inv(V + 1e-9 * np.eye(3) * np.trace(V, axis1=1, axis2=2)[:, None, None])
    taken = np.einsum("nij,njk,nik->ni", at.by_point, inverse[problem.seen.landmark], at.by_point) * weights
    square = np.where(np.isfinite(at.residuals), weights * at.residuals**2, 0.0)
    redundancy = np.where(weights > 0, 1 - taken, 0.0)
    kinds = _kinds(problem.seen).ravel()
    total, count = (np.bincount(kinds, weights=values.ravel(), minlength=len(KINDS)) for values in (square, redundancy))
    return np.sqrt(np.where(count > 1, total / np.maximum(count, 1), 1.0))


def _with_noise(problem: Problem, factors: Array) -> Problem:
    """The problem with the stated noise multiplied by factors (3,), by kind."""
    seen = problem.seen
    of = factors[_kinds(seen)]
    return replace(problem, seen=replace(seen, root=seen.root / of[:, :1, None], reading_sigma=seen.reading_sigma * of[:, 2]))


def exp(xi: Array) -> Array:
    """The transforms (N, 4, 4) of increments (N, 6)."""
    return np.asarray(se3.exp(torch.from_numpy(xi)).numpy())
