"""Alignment of a frame to the map: its depth to the zero level of the SDF, its image to those of earlier keyframes.

Gauss-Newton on SE(3) with robust weights, coarse to fine. Depth constrains the pose wherever the map has shape. Where the shape leaves a
direction open (a bare wall), the brightness of the keyframes' landmarks constrains it. A direction that neither constrains keeps its guess.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np
import torch
from torch import Tensor

from idfslam.alignment.constants import LEAST_SLOPE, MAPPED, SLOPE_FLOOR
from idfslam.alignment.motion import Information, change_between, moved
from idfslam.alignment.normals import smoothed_normals
from idfslam.alignment.photometric import Appearance, Landmarks, landmarks, photometric_term, pyramid
from idfslam.compute.backend import pick
from idfslam.config import AlignmentConfig
from idfslam.frame import Status
from idfslam.geometry import se3
from idfslam.geometry.camera import Camera
from idfslam.graph.keyframe import Images, Keyframe
from idfslam.sensing.depth_noise import noise_ratio
from idfslam.sensing.vignette import Vignette
from idfslam.storage.state import State, Stateful

# All of these were chosen by hand on generated rooms and redkitchen.

# [1] Bound on the prediction error: `_MARGIN` times the largest recent one, which decays by the factor `_DECAY` a frame.
# More: coarser images are used more often, which is slower and safer.
_MARGIN, _DECAY = 1.5, 0.95
# [1] Photometric error of a landmark that shows another place. More: landmarks out of view count more against a pose.
_WRONG_ERROR = 0.1
# [1], [m] Added to the photometric error and to the RMSE in a score. More: small differences decide less.
_ERROR_FLOOR, _RMSE_FLOOR = 0.005, 0.003
# [1] Rate of the running mean of the photometric error. More: the mean follows the last frames faster.
_USUAL_RATE = 0.1
# Every so many points one takes part in the coarse steps. More: faster, and noisier first steps.
_COARSE_STRIDE = 3
# [1] Factor on `robust` in the first step, halved with each step. More: worse guesses are corrected, and more outliers count.
_FIRST_SCALE = 4.0
# [1] An alignment that moves by more than this many times the expected error of its guess has left the reach of its images.
# More: fewer second tries.
_OVERSHOOT = 2.0


@dataclass(frozen=True)
class Alignment:
    """The pose of a frame, and how well depth and images constrain and confirm it."""

    T_wc: Tensor  # (4, 4) float64
    status: Status
    overlap: float  # share of the points that lie near a mapped surface
    rmse: float  # [m] of the robustly weighted distances
    min_eigenvalue: float  # smallest eigenvalue of the information of depth, per unit weight [1]; small: degenerate
    photometric_error: float  # scale of the brightness differences to the references' landmarks in view [1]; 0 without landmarks
    in_view: float  # share of the references' landmarks that are in view; 1 without landmarks
    information: Information | None  # of depth and images together; None for a frame without depth
    iterations: int
    focal: float = 1.0  # focal length of the finest image [px]
    radius: float = 1.0  # mean distance of the points [m]

    @property
    def least_information(self) -> float:
        """Smallest eigenvalue of the information of depth and images, per unit weight [1]; 0 without information."""
        return 0.0 if self.information is None else float(self.information.values[0])

    @property
    def score(self) -> float:
        """Quality of an alignment, to compare several of one view: overlap over photometric error and RMSE; 0 if lost.

        A landmark out of view counts as a wrong one. Otherwise a pose that looks away from all landmarks would score best.
        """
        agreement = self.in_view / (self.photometric_error + _ERROR_FLOOR) + (1 - self.in_view) / (_WRONG_ERROR + _ERROR_FLOOR)
        return 0.0 if self.status is Status.LOST else self.overlap * agreement / (self.rmse + _RMSE_FLOOR)

    def distance(self, T_wc: Tensor) -> float:
        """About how far the finest image moves between this pose and another one (4, 4) [px]."""
        change = change_between(T_wc, self.T_wc)
        return self.focal * float(change[3:].norm() + change[:3].norm() / max(self.radius, 0.1))


@dataclass(frozen=True)
class Surface:
    """N points of a frame, in the camera's frame."""

    points: Tensor  # (N, 3) [m]
    sigma: Tensor  # (N,) noise of the depth, relative to the sensor's best [1]
    patches: Tensor  # (rows, columns) int32: index of the point in each patch of the image, -1 for a patch without a point

    def every(self, step: int) -> "Surface":
        """Every `step`-th point."""
        kept = (self.patches >= 0) & (self.patches % step == 0)
        patches = torch.where(kept, self.patches // step, -1)
        return Surface(self.points[::step].contiguous(), self.sigma[::step].contiguous(), patches)


@dataclass(frozen=True)
class _System:
    """Normal equations H delta = b of a pose; delta is a shift and a turn about the camera's centre, both along world axes."""

    H: Tensor  # (6, 6) float64
    b: Tensor  # (6,)
    weight: float  # sum of the robust weights
    overlap: float  # share of the points that take part
    rmse: float  # [m]
    radius: float  # mean distance of the points [m], by which a turn is compared with a shift


_Normals = tuple[Tensor, Tensor]  # unit normals (N, 3), and the slope (N,) of the distance along them

MapQuery = Callable[[Tensor], tuple[Tensor, Tensor]]
"""Points (N, 3) [m] in the world -> signed distance (N,) [m] and its gradient (N, 3)."""


class MapAligner(Stateful):
    """Aligns views to a map and to the images of keyframes. Both may change between calls."""

    def __init__(self, config: AlignmentConfig, query: MapQuery, truncation: float, generator: torch.Generator) -> None:
        """query: the map's signed distance. truncation: the map's truncation distance [m]. generator: draws the points."""
        self.config, self.query, self.truncation, self._generator = config, query, truncation, generator
        self._appearances: WeakKeyDictionary[Images, Appearance] = WeakKeyDictionary()
        self._landmarks: WeakKeyDictionary[Keyframe, Landmarks] = WeakKeyDictionary()
        self.vignette: Vignette | None = None  # is taken out of images before their brightness is compared
        self._usual_error = 0.0
        self.expected: float | None = None  # bound on the error of a prediction [px of the finest image]; None before the first frame

    def state(self) -> State:
        """The usual photometric error, the bound on the prediction error, and the generator."""
        expected = math.inf if self.expected is None else self.expected
        return {"usual_error": self._usual_error, "expected": expected, "generator": self._generator.get_state()}

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        self._usual_error = state["usual_error"]
        self.expected = state["expected"] if math.isfinite(state["expected"]) else None
        self._generator.set_state(state["generator"])

    def align(
        self,
        view: Keyframe,
        T_guess: Tensor,
        references: Sequence[Keyframe],
        *,
        max_guess_error_px: float | None = None,
        registered: bool = False,
    ) -> Alignment:
        """Aligns a view to the map and to the images of `references`, starting at `T_guess` (4, 4); LOST if too few pixels have depth.

        max_guess_error_px: bound on the error of the guess, in pixels of the finest image. The steps on images too coarse for it are left
        out. None: unknown. registered: the guess comes from the neural tracker and is as exact as the result. It gets a stronger prior in
        the directions that map and images constrain weakly.
        """
        prior_information = self.config.registration_prior_information if registered else self.config.prior_information
        surface = self.surface(view)
        if len(surface.points) < self.config.min_points:
            return Alignment(T_guess, Status.LOST, 0.0, float("nan"), 0.0, 0.0, 0.0, None, 0)
        T, change = T_guess.double().clone(), torch.zeros(6, dtype=torch.float64)
        coarse_steps = (self.config.image_levels - 1) * self.config.steps_a_level
        first = min(self._first_step(0.0 if registered else max_guess_error_px), self.config.iterations - 1)
        coarse, normals = surface.every(_COARSE_STRIDE), None
        for step in range(first, self.config.iterations):
            if step < coarse_steps:
                system, _ = self._depth_system(coarse, T, step, None)
            else:  # the normals of the first fine step are used again: they hardly turn any more
                system, normals = self._depth_system(surface, T, step, normals)
            H, b, photometric_error, in_view = self._with_images(system, view, references, T, step)
            largest = damped_step(H, b, system.weight, system.radius, prior_information, change, T)
            if step >= coarse_steps and largest < self.config.converged:
                break
        information = Information.of(H, system.weight, system.radius)
        focal = self.appearance(view).levels[0].camera.fx
        return self._judged(T, system, information, photometric_error, in_view, step + 1 - first, focal)

    def _first_step(self, max_guess_error_px: float | None) -> int:
        """The first step for a guess with this largest error: it is at most `level_reach` pixels of the coarsest level used."""
        levels = self.config.image_levels
        if max_guess_error_px is None:
            return 0
        level = math.ceil(math.log2(max(max_guess_error_px / self.config.level_reach, 1.0)))
        return max(0, levels - 1 - level) * self.config.steps_a_level

    def surface(self, view: Keyframe) -> Surface:
        """About `config.points` points of a view: a random pixel of each of equal patches, if it has depth.

        Patches are smaller if few pixels have depth. A table near the end of the sensor's range may be all there is to align to.
        """
        height, width = view.depth.shape
        patch = max(1, round((int((view.depth > 0).sum()) / self.config.points) ** 0.5))
        rows, columns = height // patch, width // patch
        jitter = torch.randint(patch, (2, rows, columns), generator=self._generator)
        return pick(view.depth, compiled=compiled_surface, plain=plain_surface)(view.depth, view.camera, jitter, patch)

    def is_doubtful(self, alignment: Alignment) -> bool:
        """Whether another guess should be tried: the view is lost, overlaps little with the map, or has a large photometric error."""
        return (
            alignment.status is Status.LOST
            or alignment.overlap < self.config.doubtful_overlap
            or not self.photometric_error_within(alignment, self.config.doubtful_brightness)
        )

    def photometric_error_within(self, alignment: Alignment, ratio: float) -> bool:
        """Whether the photometric error is at most `ratio` times the usual one."""
        return alignment.photometric_error <= ratio * self._expected_error

    @property
    def doubtful_error(self) -> float:
        """Photometric error [1] above which the images do not match: it is more than noise."""
        return self.config.doubtful_brightness * self._expected_error

    @property
    def _expected_error(self) -> float:
        return max(self._usual_error, self.config.colour_noise)

    @property
    def has_usual_error(self) -> bool:
        """Whether the usual photometric error is available: a frame was aligned, or `expect` was called."""
        return self._usual_error > 0

    def expect(self, differences: Sequence[float]) -> None:
        """Initialises the usual photometric error with the median of some errors, before the first alignment.

        An error of 0 means that nothing was in view, and is left out.
        """
        if measured := sorted(difference for difference in differences if difference > 0):
            self._usual_error = measured[len(measured) // 2]

    def accept(self, alignment: Alignment, T_predicted: Tensor) -> None:
        """Updates the usual photometric error, a running mean, and the bound on the error of predictions such as `T_predicted` (4, 4)."""
        if alignment.photometric_error > 0:
            self._usual_error += (alignment.photometric_error - self._usual_error) * (_USUAL_RATE if self._usual_error else 1.0)
        decayed = 0.0 if self.expected is None else _DECAY * self.expected
        self.expected = max(_MARGIN * alignment.distance(T_predicted), decayed)

    def unexpected(self, alignment: Alignment, T_guess: Tensor, max_guess_error_px: float | None) -> bool:
        """Whether the pose moved farther from its guess than the images reach that were used for this largest error of the guess."""
        return max_guess_error_px is not None and alignment.distance(T_guess) > _OVERSHOOT * max(
            max_guess_error_px, self.config.level_reach
        )

    def _depth_system(self, surface: Surface, T: Tensor, step: int, normals: _Normals | None) -> tuple[_System, _Normals]:
        """Normal equations of the points' distances to the map along its normals. The robust scale narrows over the first steps.

        normals: of an earlier step; None: they are computed at the points' present places. Returns the normals too.
        """
        T32 = T.float().to(surface.points)
        turned = surface.points @ T32[:3, :3].T
        distance, gradient = self.query(turned + T32[:3, 3])
        robust = self.config.robust * max(1.0, _FIRST_SCALE * 0.5**step)
        normals = normals or smoothed_normals(turned, gradient, surface.patches)
        return depth_system(turned, distance, *normals, surface.sigma, self.truncation, robust, self.config.robust_widest), normals

    def _with_images(
        self, system: _System, view: Keyframe, references: Sequence[Keyframe], T: Tensor, step: int
    ) -> tuple[Tensor, Tensor, float, float]:
        """Adds to the normal equations the brightness of each reference's landmarks, on the level of the pyramid for this step.

        Returns H (6, 6), b (6,), the scale of the brightness differences, and the share of the landmarks in view.
        """
        H, b, photometric_error, seen, in_view, count = system.H, system.b, 0.0, 0, 0, 0
        frame = self.appearance(view)
        level = max(0, self.config.image_levels - 1 - step // self.config.steps_a_level)
        for reference in references:
            marks = self.landmarks(reference)
            noise, widest = self.config.colour_noise, self.config.colour_robust
            term = photometric_term(frame, marks, reference.T_wk, T, level, floor=noise, widest=widest)
            count, in_view = count + len(marks.points), in_view + term.seen
            if term.seen < self.config.min_landmarks:
                continue
            H = H + self.config.depth_noise**2 * term.H
            b = b + self.config.depth_noise**2 * term.b
            photometric_error, seen = photometric_error + term.seen * term.noise, seen + term.seen
        return H, b, photometric_error / max(seen, 1), in_view / count if count else 1.0

    def photometric_comparison(self, view: Keyframe, reference: Keyframe, T_wc: Tensor) -> tuple[float, float]:
        """The share of a reference's landmarks that a view at `T_wc` (4, 4) sees, and the scale of their brightness differences."""
        marks, noise, widest = self.landmarks(reference), self.config.colour_noise, self.config.colour_robust
        term = photometric_term(self.appearance(view), marks, reference.T_wk, T_wc, 0, floor=noise, widest=widest)
        return term.seen / max(len(marks.points), 1), term.noise

    def appearance(self, view: Keyframe) -> Appearance:
        """A view's image pyramid, cached for as long as its images are in memory."""
        images = view.images
        if images not in self._appearances:
            height, levels = self.config.image_height, self.config.image_levels
            of_view = pyramid(images.colour, view.camera, height=height, levels=levels, vignette=self.vignette)
            self._appearances[images] = Appearance(of_view, images.depth, view.camera)
        return self._appearances[images]

    def landmarks(self, keyframe: Keyframe) -> Landmarks:
        """A keyframe's landmarks, cached. Its pyramid is released: other images are compared with the landmarks alone."""
        if keyframe not in self._landmarks:
            appearance = self.appearance(keyframe)
            self._landmarks[keyframe] = landmarks(appearance.levels, keyframe.depth, count=self.config.landmarks)
            self.release(keyframe)
        return self._landmarks[keyframe]

    def take_out(self, vignette: Vignette | None) -> None:
        """Takes this vignetting out of all images from now on."""
        self.vignette = vignette
        self._appearances.clear()
        self._landmarks.clear()

    def release(self, view: Keyframe) -> None:
        """Frees a view's image pyramid. It is computed again when it is needed again."""
        self._appearances.pop(view.images, None)

    def _judged(
        self, T: Tensor, system: _System, information: Information, photometric_error: float, in_view: float, iterations: int, focal: float
    ) -> Alignment:
        of_depth = Information.of(system.H, system.weight, system.radius)
        min_eigenvalue = float(of_depth.values[0])
        status = Status.OK
        if system.overlap < self.config.min_overlap or system.rmse > self.config.max_rmse:
            status = Status.LOST
        elif min_eigenvalue < self.config.min_eigenvalue:
            status = Status.DEGENERATE
        # Images that do not match say nothing about the motion.
        trusted = of_depth if photometric_error > self.doubtful_error else information
        evidence = system.overlap, system.rmse, min_eigenvalue, photometric_error, in_view, trusted
        return Alignment(se3.orthonormal(T), status, *evidence, iterations, focal, system.radius)


def plain_surface(depth: Tensor, camera: Camera, jitter: Tensor, patch: int) -> Surface:
    """One pixel of each patch of a depth image (H, W) [m], if it has depth; in torch, on any device.

    jitter (2, rows, columns): row and column of the pixel within its patch.
    """
    rows, columns = jitter.shape[1:]
    v = (torch.arange(rows)[:, None] * patch + jitter[0]).flatten().to(depth.device)
    u = (torch.arange(columns)[None] * patch + jitter[1]).flatten().to(depth.device)
    z = depth[v, u]
    keep = z > 0
    patches = torch.where(keep, keep.cumsum(0) - 1, -1).int().view(rows, columns)
    v, u, z = v[keep], u[keep], z[keep]
    points = camera.rays(torch.stack([u, v], -1).to(z.dtype)) * z[:, None]
    return Surface(points, noise_ratio(z), patches)


def compiled_surface(depth: Tensor, camera: Camera, jitter: Tensor, patch: int) -> Surface:
    """`plain_surface` by Numba, on the CPU."""
    from idfslam.alignment.kernels import numba_alignment

    points, z = torch.empty(jitter[0].numel(), 3), torch.empty(jitter[0].numel())
    patches = torch.empty(jitter.shape[1:], dtype=torch.int32)
    intrinsics = [np.float32(value) for value in (camera.fx, camera.fy, camera.cx, camera.cy)]
    outputs = points.numpy(), z.numpy(), patches.numpy()
    count = numba_alignment.patch_points(depth.numpy(), jitter.numpy(), patch, *intrinsics, *outputs)  # type: ignore[call-arg]
    return Surface(points[:count], noise_ratio(z[:count]), patches)


def damped_step(H: Tensor, b: Tensor, weight: float, radius: float, prior_information: float, change: Tensor, T: Tensor) -> float:
    """A Gauss-Newton step of normal equations H (6, 6), b (6,), with a prior at the guess for directions with little information.

    prior_information: information [1] below which the prior dominates (`Information.prior`). The step moves in place the pose T (4, 4) and
    its change since the guess, change (6,). Returns the largest entry of the step. All tensors are on the host, wherever the points are.
    """
    return pick(H, compiled=compiled_damped_step, plain=plain_damped_step)(H, b, weight, radius, prior_information, change, T)


def compiled_damped_step(H: Tensor, b: Tensor, weight: float, radius: float, prior_information: float, change: Tensor, T: Tensor) -> float:
    """`damped_step` by Numba, on the CPU."""
    from idfslam.alignment.kernels import numba_alignment

    return float(numba_alignment.damped_step(H.numpy(), b.numpy(), weight, radius, prior_information, change.numpy(), T.numpy()))  # type: ignore[call-arg]


def plain_damped_step(H: Tensor, b: Tensor, weight: float, radius: float, prior_information: float, change: Tensor, T: Tensor) -> float:
    """`damped_step` in torch, on any device."""
    P = Information.of(H, weight, radius).prior(prior_information)
    delta = torch.linalg.solve(H + P, b - P @ change)
    change += delta
    T[:] = moved(T, delta)
    return float(delta.abs().max())


def depth_system(
    turned: Tensor, distance: Tensor, normal: Tensor, slope: Tensor, sigma: Tensor, truncation: float, robust: float, widest: float
) -> _System:
    """Normal equations of the distances (N,) [m] of points to the map, along its normals (N, 3).

    turned (N, 3) [m]: the points from the camera's centre, along world axes. slope (N,): the length of the distance's gradient.
    sigma (N,): the noise relative to the sensor's best. robust [m]: scale of the robust kernel. widest: the largest sigma that widens it.
    """
    build = pick(turned, compiled=compiled_depth_system, plain=plain_depth_system)
    return build(turned, distance, normal, slope, sigma, truncation, robust, widest)


def compiled_depth_system(
    turned: Tensor, distance: Tensor, normal: Tensor, slope: Tensor, sigma: Tensor, truncation: float, robust: float, widest: float
) -> _System:
    """`depth_system` by Numba, on the CPU."""
    from idfslam.alignment.kernels import numba_alignment

    H, b = torch.zeros(6, 6, dtype=torch.float64), torch.zeros(6, dtype=torch.float64)
    arrays = [t.numpy() for t in (turned, distance, normal, slope, sigma)]
    sums = numba_alignment.depth_system(*arrays, truncation, robust, widest, H.numpy(), b.numpy())  # type: ignore[call-arg]
    weight, squares, count, radius = sums
    return _System(H, b, weight, count / len(distance), (squares / max(weight, 1e-9)) ** 0.5, radius)


def plain_depth_system(
    turned: Tensor, distance: Tensor, normal: Tensor, slope: Tensor, sigma: Tensor, truncation: float, robust: float, widest: float
) -> _System:
    """`depth_system` in torch, on any device."""
    mapped = (distance.abs() < MAPPED * truncation) & (slope > LEAST_SLOPE)
    r = distance / slope.clamp(min=SLOPE_FLOOR)
    J = torch.cat([normal, torch.linalg.cross(turned, normal)], -1)
    scale = robust * sigma.clamp(max=widest)
    w = mapped / ((1 + (r / scale) ** 2) ** 2 * sigma**2)  # Geman-McClure, divided by the sensor's variance
    JtW = (J * w[:, None]).T
    weight = float(w.sum())
    rmse = (float((w * r * r).sum()) / max(weight, 1e-9)) ** 0.5
    overlap = float(mapped.float().mean())
    return _System((JtW @ J).double().cpu(), -(JtW @ r).double().cpu(), weight, overlap, rmse, float(turned.norm(dim=-1).mean()))
