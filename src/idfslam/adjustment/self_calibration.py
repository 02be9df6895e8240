"""Self-calibration: the camera that makes all views of a scene fit together, from keyframes at roughly right poses.

Tracks and adjustment take turns, since a better camera gives better tracks. A value is estimated only where the recordings determine it:
where its posterior standard deviation is clearly below that of what such cameras are stated wrongly by.

The scale of depth is not among them. Whatever it is, there is a world of another size in which the same images and readings fit as well.
Poses that are known from elsewhere tell it (`with_scale`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from idfslam.adjustment.bundle_adjustment import KINDS, Adjusted, Problem, adjust, adjust_briefly, in_motion
from idfslam.adjustment.camera_model import NAMES, PRIORS, CameraModel
from idfslam.adjustment.landmark_tracks import KeyframeView, features_of, find_tracks
from idfslam.adjustment.observations import Array, Observations, determined
from idfslam.adjustment.row_motion import KeyframeMotion
from idfslam.geometry.camera import Camera
from idfslam.geometry.trajectory import align

_DETERMINED = 0.25  # [1] largest posterior standard deviation of a value that is estimated, as a share of its prior; raised, values are
#    estimated from weaker evidence. Chosen by hand
ROUNDS = 4  # most times that tracks are searched; more: slower, a worse stated camera is mended
_SETTLED = 0.5  # [standard deviations] largest change of a value that ends the rounds; more: faster, less exact
_LEAST_KEYFRAMES = 3  # in all; more: short recordings are refused. With two, focal length and relative pose are hard to tell apart
_LEAST_LANDMARKS = 100  # in all; more: poor recordings are refused. Chosen by hand
_IN_A_ROW = 8  # keyframes whose positions are wrong in about the same way; more: the scale that true poses tell is less sure. By hand
_MISFIT = 1.5  # [1] factor on all standard deviations, for what residuals do not show: patches that are not flat, light that moves. Raised,
#    less is claimed. The errors of 6 generated calibrations were 1.35 times as large as their standard deviations, root mean square
_TIMES = 2.0  # [1] factor on the standard deviations of the sensor's times, with which these are adjusted too: estimates of generated
#    recordings were off by up to 3.9 of them. Raised, the times are left to the keyframes
_SMOOTH = 5e-4  # [1] least standard deviation of a number of depth's deformation: surfaces that are not smooth bend it. Raised, likewise
_STRETCHES = 8  # of keyframes, each of which is left out once; more: errors that last longer than a stretch are missed, slower. By hand
_STEPS = 8  # most steps of an adjustment without one of them; more: slower, more exact
_CHANCE = 0.997  # [1] stated values stay if chance alone brings this share of estimates nearer to them: 3 standard deviations of one value.
#    Raised, more stay
GROUPS = {
    "focal length": np.array([NAMES.index("focal"), NAMES.index("aspect")]),
    "principal point": np.array([NAMES.index("cx"), NAMES.index("cy")]),
    "distortion": np.array([NAMES.index("k1"), NAMES.index("k2")]),
    "depth scale": np.array([NAMES.index("depth_scale")]),
    "depth over range and image": np.arange(NAMES.index("depth_scale") + 1, len(NAMES)),
}
"""The places of values that belong together."""
_SCALE = NAMES.index("depth_scale")
EXPLAINED = 0.3
"""[px] of 640 pixels' width: largest noise of the landmarks in adjusted views that are believed.

Where blur or a shutter leave more, the camera alone does not explain the images. More: false doubts of shaken cameras. Calm generated
recordings have 0.15 to 0.2. Shaken blurred ones with a right camera have 0.4, and a principal point that looks 6 px off.
"""


@dataclass(frozen=True)
class PosedViews:
    """K keyframes of one recording, with roughly right poses T_wk (K, 4, 4), and how each moved while its images were taken."""

    views: Sequence[KeyframeView]
    poses: Array
    motions: Sequence[KeyframeMotion]
    time_sigmas: Array = field(default_factory=lambda: np.zeros(3))  # (3,) [s] of colour's read-out, depth's, and depth's delay


@dataclass(frozen=True)
class CameraEstimate:
    """The camera that fits, and how sure it is."""

    model: CameraModel
    covariance: Array  # (P, P) of its values; zero for those that are not determined
    poses: list[Array]  # (K, 4, 4) T_wk of each recording's keyframes, as they fit best
    landmarks: int
    sightings: int
    noise: float  # [px] of the landmarks' positions in images of 640 pixels' width, in the median

    @property
    def sigmas(self) -> Array:
        """(P,) standard deviations; zero for values that are not determined."""
        return np.sqrt(np.diag(self.covariance).clip(min=0))

    @property
    def explains_images(self) -> bool:
        """Whether the camera explains the images, so that its values are to be believed."""
        return self.noise <= EXPLAINED


def self_calibrate(
    recordings: Sequence[PosedViews], *, rounds: int = ROUNDS, start: CameraEstimate | None = None, explained: bool = False
) -> CameraEstimate | None:
    """The camera of recordings with one and the same camera; None if they show too little.

    rounds: most times that tracks are searched. start: an estimate from the same views to go on from. explained: None too where the
    camera does not explain the images, which the first adjustment tells: it has the most freedom to fit them.
    """
    views = [view for part in recordings for view in part.views]
    if len(views) < _LEAST_KEYFRAMES:
        return None
    motions = [motion for part in recordings for motion in part.motions]
    time_sigmas = _TIMES * np.array([part.time_sigmas for part in recordings])
    poses = np.concatenate([part.poses for part in recordings] if start is None else start.poses)
    starts = np.cumsum([0, *(len(part.views) for part in recordings)])
    of = np.repeat(np.arange(len(recordings)), np.diff(starts))
    fixed = np.isin(np.arange(len(views)), starts[:-1])
    model, estimated = CameraModel.as_stated(views[0].camera), np.arange(len(NAMES)) != _SCALE
    if start is not None:
        model, estimated = start.model, start.sigmas > 0
    for i in range(rounds):
        images = [features_of(view, model) for view in views]
        points, seen = find_tracks(views, images, poses, model, recordings=of, coarse=i == 0 and start is None)
        if len(points) < _LEAST_LANDMARKS:
            return None
        before = model.values
        problem = in_motion(Problem(model, poses, points, seen, fixed, estimated), motions, of, time_sigmas)
        adjusted = adjust(problem)
        if explained and noise_of(adjusted.problem.seen, views[0].camera.width) > EXPLAINED:
            return None
        adjusted, estimated = _determined(problem, adjusted)
        model, poses, covariance = adjusted.problem.model, adjusted.problem.poses, adjusted.values_covariance()
        sigmas = np.sqrt(np.diag(covariance).clip(min=1e-30))
        if i and (np.abs(model.values - before) < _SETTLED * sigmas)[estimated].all():
            break
    kept = adjusted.problem.seen
    own = np.sqrt(np.diag(covariance).clip(min=0))
    covariance = _with_sigmas(_honest(covariance), _moderated(_by_jackknife(adjusted.problem, of), own))
    return CameraEstimate(
        model, covariance, np.split(poses, starts[1:-1]), len(adjusted.problem.points), len(kept), noise_of(kept, views[0].camera.width)
    )


def _honest(covariance: Array) -> Array:
    """The covariance (P, P) of an adjustment, with what its residuals do not show."""
    of_deformation = np.arange(len(NAMES)) > _SCALE
    return _MISFIT**2 * covariance + np.diag(np.where(of_deformation & (np.diag(covariance) > 0), _SMOOTH**2, 0.0))


def _by_jackknife(problem: Problem, of: NDArray[np.int64]) -> Array:
    """(P,) standard deviations of the values, by how they change without each stretch of keyframes; zero if too few are left then.

    of (K,): the number of each keyframe's recording. Keyframes near in time share errors that the model does not know, of a motion within
    their rows, a clock, or light, so they are left out together (Tukey's jackknife, by groups: Efron and Stein, 1981).
    """
    count = min(_STRETCHES, len(of))
    stretch = np.arange(len(of)) * count // len(of)
    values = []
    for i in range(count):
        left = stretch != i
        chosen = np.flatnonzero(left)
        first_of_each = np.isin(np.arange(len(of)), chosen[np.unique(of[left], return_index=True)[1]])
        points, seen = determined(problem.points, problem.seen[left[problem.seen.keyframe]])
        if left.sum() < _LEAST_KEYFRAMES or len(points) < _LEAST_LANDMARKS // 2:
            return np.zeros(len(NAMES))
        without = replace(problem, points=points, seen=seen, fixed=~left | first_of_each)
        values.append(adjust_briefly(without, noise=np.ones(len(KINDS)), steps=_STEPS)[0].model.values)
    return np.asarray(np.sqrt((count - 1) * np.var(values, axis=0)))


def _moderated(jackknife: Array, own: Array) -> Array:
    """(P,) standard deviations of the values, from those by the jackknife, and the adjustment's own, which are zero if not estimated.

    Eight stretches tell a deviation to a quarter of it only. How many times their own deviation values err is much the same for all of a
    lens, and for all of depth. So each variance is averaged with that by the mean of its kind (Smyth, 2004, of many variances).
    """
    out = jackknife.copy()
    for kind in (np.arange(len(NAMES)) < _SCALE, np.arange(len(NAMES)) > _SCALE):
        at = kind & (own > 0)
        if at.any():
            times_own = np.mean((jackknife[at] / own[at]) ** 2)
            out[at] = np.sqrt((jackknife[at] ** 2 + times_own * own[at] ** 2) / 2)
    return out


def _with_sigmas(covariance: Array, least: Array) -> Array:
    """The covariance (P, P) with standard deviations of at least these (P,)."""
    sigmas = np.sqrt(np.diag(covariance).clip(min=1e-30))
    factors = np.maximum(1.0, least / sigmas)
    return covariance * np.outer(factors, factors)


def _determined(problem: Problem, adjusted: Adjusted) -> tuple[Adjusted, NDArray[np.bool_]]:
    """The adjustment in which only values are estimated that it determines, and which these are. adjusted: the first one."""
    prior = np.array(list(PRIORS.values()))
    while True:
        sigmas = np.sqrt(np.diag(adjusted.values_covariance()).clip(min=0))
        weak = problem.estimated & (sigmas > _DETERMINED * prior)
        if not weak.any():
            return adjusted, problem.estimated
        values = np.where(weak, 0.0, problem.model.values)
        problem = replace(problem, estimated=problem.estimated & ~weak, model=replace(problem.model, values=values))
        adjusted = adjust(problem)


def fitting(estimate: CameraEstimate) -> list[str]:
    """The names of GROUPS whose values may well be as stated: together they are no farther from it than their covariance explains."""
    return _kept(estimate)[0]


def confirmed(estimate: CameraEstimate) -> CameraModel:
    """The camera with its stated values wherever they fit, and the others as they are then: conditioned on these."""
    return replace(estimate.model, values=_kept(estimate)[1])


def _kept(estimate: CameraEstimate) -> tuple[list[str], Array]:
    """The groups that stay as stated, the best fitting first, and the values (P,) given that they do."""
    values, C, kept = estimate.model.values, estimate.covariance, list[str]()
    while True:
        worst = {name: _surprise(values, C, places) for name, places in GROUPS.items() if name not in kept and C[places, places].any()}
        if not worst or min(worst.values()) >= 1:
            return kept, values
        name = min(worst, key=lambda group: worst[group])
        at = GROUPS[name][C[GROUPS[name], GROUPS[name]] > 0]
        gain = C[:, at] @ np.linalg.inv(C[np.ix_(at, at)])
        values, C, kept = values - gain @ values[at], C - gain @ C[at], [*kept, name]
        values[GROUPS[name]] = C[GROUPS[name]] = C[:, GROUPS[name]] = 0


def _surprise(values: Array, C: Array, places: NDArray[np.int64]) -> float:
    """The squared deviation of some values from the stated ones, in units of what chance explains."""
    at = places[C[places, places] > 0]
    by_chance = 2 * gammaincinv(len(at) / 2, _CHANCE)  # the quantile of the chi-squared distribution
    return float(values[at] @ np.linalg.solve(C[np.ix_(at, at)], values[at]) / by_chance)


def with_scale(estimate: CameraEstimate, truth: Sequence[Array]) -> CameraEstimate | None:
    """The estimate with the scale of depth that true poses (K, 4, 4) of each recording's keyframes tell, NaN: unknown.

    None if fewer than three keyframes of a recording have one, or if the camera stood still.
    """
    along, square, count = 0.0, 0.0, 0
    pairs = []
    for poses, true in zip(estimate.poses, truth):
        known = np.isfinite(true).all((1, 2))
        if known.sum() >= 3:
            x, y = poses[known, :3, 3], true[known, :3, 3]
            T = align(x, y)
            x = (x - x.mean(0)) @ T[:3, :3].T
            pairs.append((x, y - y.mean(0)))
            along, square, count = along + float((x * pairs[-1][1]).sum()), square + float((x * x).sum()), count + len(x)
    if square < 1e-4 * max(count, 1):
        return None
    scale = along / square
    off = sum(float(((y - scale * x) ** 2).sum()) for x, y in pairs)
    sigma = np.sqrt(off / (3 * count) / square * _IN_A_ROW)
    values, covariance = estimate.model.values.copy(), estimate.covariance.copy()
    values[_SCALE] += 1
    values[_SCALE:] *= scale
    values[_SCALE] -= 1
    covariance[_SCALE, _SCALE] = sigma**2
    return replace(estimate, model=replace(estimate.model, values=values), covariance=covariance)


def noise_of(seen: Observations, width: int) -> float:
    """The median noise of adjusted positions in images of this width [px], for images of 640 pixels' width."""
    return float(np.median(1 / np.sqrt(np.abs(np.linalg.det(seen.root)))) * 640 / width)


def of_size(model: CameraModel, camera: Camera) -> CameraModel:
    """The same deviations from the same camera of images of another size."""
    return CameraModel(camera, model.values)
