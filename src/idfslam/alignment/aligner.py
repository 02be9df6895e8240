"""Second-order alignment of a frame to the map: depth on the zero of the SDF, images on those of earlier keyframes.

Gauss-Newton on SE(3) with robust weights, coarse to fine. Depth holds the frame to everything mapped so far; where the map's
shape leaves a direction open (a bare wall) the brightness of keyframes' landmarks decides, and what neither decides stays at the guess.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np
import torch
from torch import Tensor

from idfslam.alignment.constants import KNOWN, LEAST_SLOPE, SLOPE_FLOOR
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
from idfslam.storage.state import State, Stateful

# Chosen by hand on generated rooms and redkitchen.
_MARGIN, _DECAY = (
    1.5,
    0.95,
)  # [1] the prediction error is bounded by this many times the largest recent one, which decays by 5 % a frame. More
#                              margin: coarser images are used more often, which is slower and safer
_WRONG_ERROR = 0.1  # [1] photometric error of a landmark that is another place; more: landmarks out of view count against a pose more
_ERROR_FLOOR, _RMSE_FLOOR = 0.005, 0.003  # [1], [m] added to photometric error and RMSE in a score; more: small differences decide less
_USUAL_RATE = 0.1  # [1] by which the usual photometric error follows each frame's; more: it follows faster, and forgets faster
_COARSE_STRIDE = 3  # points of which one takes part in all but the finest steps; more: faster, and noisier first steps
_FIRST_SCALE = 4.0  # [1] times `robust` in the first step, halved with each; more: worse guesses are corrected, and more outliers count
_OVERSHOOT = 2.0  # [1] times the expected error of a guess, beyond which coarser images are needed after all; more: fewer second tries


@dataclass(frozen=True)
class Alignment:
    """A pose with its evidence."""

    T_wc: Tensor  # (4, 4) float64
    status: Status
    overlap: float  # share of the points that fall where the map knows the surface
    rmse: float  # [m] of the robustly weighted distances
    stiffness: float  # least information of depth in any direction, per unit weight [1]; small: degenerate
    brightness: float  # typical difference of brightness to the references' landmarks in view, 0 without any
    in_view: float  # share of the references' landmarks that are in view, 1 of none
    information: Information | None  # of depth and images together; None without depth
    iterations: int
    focal: float = 1.0  # of the finest image [px]
    radius: float = 1.0  # mean distance of the points [m]

    @property
    def least_information(self) -> float:
        """Of depth and images in any direction, per unit weight [1]; 0 without any."""
        return 0.0 if self.information is None else float(self.information.values[0])

    @property
    def score(self) -> float:
        """To compare two alignments of one view: much of it explained, closely, and in its colours; 0 if lost.

        A landmark out of view counts as one that is wrong, or the pose that looks away from all of them would be best.
        """
        agreement = self.in_view / (self.brightness + _ERROR_FLOOR) + (1 - self.in_view) / (_WRONG_ERROR + _ERROR_FLOOR)
        return 0.0 if self.status is Status.LOST else self.overlap * agreement / (self.rmse + _RMSE_FLOOR)

    def distance(self, T_wc: Tensor) -> float:
        """How far the finest image moves between this pose and another (4, 4), about [px]."""
        change = change_between(T_wc, self.T_wc)
        return self.focal * float(change[3:].norm() + change[:3].norm() / max(self.radius, 0.1))


@dataclass(frozen=True)
class Surface:
    """N points of a frame in the camera's frame."""

    points: Tensor  # (N, 3) [m]
    sigma: Tensor  # (N,) noise of the depth, relative to the best of the sensor [1]
    patches: Tensor  # (rows, columns) int32: which of the points lies in each patch of the image, -1 where there is none

    def every(self, step: int) -> "Surface":
        """Each `step`-th point."""
        kept = (self.patches >= 0) & (self.patches % step == 0)
        patches = torch.where(kept, self.patches // step, -1)
        return Surface(self.points[::step].contiguous(), self.sigma[::step].contiguous(), patches)


@dataclass(frozen=True)
class _System:
    """Normal equations H delta = b of a pose: shift, and turn about the camera's own centre, both along world axes."""

    H: Tensor  # (6, 6) float64
    b: Tensor  # (6,)
    weight: float  # sum of the robust weights
    overlap: float
    rmse: float
    radius: float  # mean distance of the points [m], to compare a turn with a shift


_Normals = tuple[Tensor, Tensor]  # (N, 3) unit, and the slope (N,) of the distance along them

MapQuery = Callable[[Tensor], tuple[Tensor, Tensor]]
"""Points (N, 3) [m] in the world -> signed distance (N,) [m] and its gradient (N, 3)."""


class Aligner(Stateful):
    """Aligns views to a map and to the images of keyframes; both may change between calls."""

    def __init__(self, config: AlignmentConfig, query: MapQuery, truncation: float, generator: torch.Generator) -> None:
        """query: the map's signed distance; truncation: that of the map [m]."""
        self.config, self.query, self.truncation, self._generator = config, query, truncation, generator
        self._appearances: WeakKeyDictionary[Images, Appearance] = WeakKeyDictionary()
        self._landmarks: WeakKeyDictionary[Keyframe, Landmarks] = WeakKeyDictionary()
        self._usual_brightness = 0.0
        self.expected: float | None = None  # how far off a prediction is at most, judging by the last ones [px of the finest image]

    def state(self) -> State:
        """How well colours usually fit, how far off predictions are, and the generator."""
        expected = math.inf if self.expected is None else self.expected
        return {"usual_brightness": self._usual_brightness, "expected": expected, "generator": self._generator.get_state()}

    def restore(self, state: State) -> None:
        """What `state` told."""
        self._usual_brightness = state["usual_brightness"]
        self.expected = state["expected"] if math.isfinite(state["expected"]) else None
        self._generator.set_state(state["generator"])

    def align(
        self, view: Keyframe, T_guess: Tensor, references: Sequence[Keyframe], *, within: float | None = None, registered: bool = False
    ) -> Alignment:
        """The view's pose near `T_guess` (4, 4), held to the map and to the images of `references`; LOST if it has no depth.

        within: how far off the guess may be [px of the finest image], which spares coarser images; none given: unknown. registered: it
        is as good as the answer, and comes from the neural tracker: directions that map and images know little of are held to it more
        firmly than to another guess.
        """
        hold = self.config.registration_prior_information if registered else self.config.prior_information
        surface = self.surface(view)
        if len(surface.points) < self.config.min_points:
            return Alignment(T_guess, Status.LOST, 0.0, float("nan"), 0.0, 0.0, 0.0, None, 0)
        T, change = T_guess.double().clone(), torch.zeros(6, dtype=torch.float64)
        coarse_steps = (self.config.image_levels - 1) * self.config.steps_a_level
        first = min(self._first_step(0.0 if registered else within), self.config.iterations - 1)
        coarse, normals = surface.every(_COARSE_STRIDE), None
        for step in range(first, self.config.iterations):
            if step < coarse_steps:
                system, _ = self._depth_system(coarse, T, step, None)
            else:  # near the end they turn no more
                system, normals = self._depth_system(surface, T, step, normals)
            H, b, brightness, in_view = self._with_images(system, view, references, T, step)
            largest = damped_step(H, b, system.weight, system.radius, hold, change, T)
            if step >= coarse_steps and largest < self.config.converged:
                break
        information = Information.of(H, system.weight, system.radius)
        focal = self.appearance(view).levels[0].camera.fx
        return self._judged(T, system, information, brightness, in_view, step + 1 - first, focal)

    def _first_step(self, within: float | None) -> int:
        """Past the images that a guess off by `within` [px] has no need of: on each level that is to be at most `level_reach` pixels."""
        levels = self.config.image_levels
        if within is None:
            return 0
        level = math.ceil(math.log2(max(within / self.config.level_reach, 1.0)))
        return max(0, levels - 1 - level) * self.config.steps_a_level

    def surface(self, view: Keyframe) -> Surface:
        """About `config.points` points of a view, one in each of equal patches, at random within it; patches without depth give none.

        Where little has depth the patches are smaller: a table at the end of the sensor's range is all there is to hold on to.
        """
        height, width = view.depth.shape
        patch = max(1, round((int((view.depth > 0).sum()) / self.config.points) ** 0.5))
        rows, columns = height // patch, width // patch
        jitter = torch.randint(patch, (2, rows, columns), generator=self._generator)
        return pick(view.depth, compiled=compiled_surface, plain=plain_surface)(view.depth, view.camera, jitter, patch)

    def doubtful(self, alignment: Alignment) -> bool:
        """Whether another guess is worth its time: lost, little overlap, or colours that fit much worse than they lately did."""
        return (
            alignment.status is Status.LOST
            or alignment.overlap < self.config.doubtful_overlap
            or not self.fits(alignment, self.config.doubtful_brightness)
        )

    def fits(self, alignment: Alignment, times: float) -> bool:
        """Whether colours differ by at most so many times what they lately did."""
        return alignment.brightness <= times * self._expected_brightness

    @property
    def doubtful_brightness(self) -> float:
        """Colours that differ more than this are not noise: the images do not lie on each other."""
        return self.config.doubtful_brightness * self._expected_brightness

    @property
    def _expected_brightness(self) -> float:
        return max(self._usual_brightness, self.config.colour_noise)

    @property
    def has_usual_error(self) -> bool:
        """Whether a frame was aligned already, or the usual photometric error was given."""
        return self._usual_brightness > 0

    def expect(self, differences: Sequence[float]) -> None:
        """How well colours usually fit, before anything was aligned: the median of differences of brightness; 0: nothing was in view."""
        if seen := sorted(difference for difference in differences if difference > 0):
            self._usual_brightness = seen[len(seen) // 2]

    def accept(self, alignment: Alignment, T_predicted: Tensor) -> None:
        """Remember how well colours fit, as a slow running mean, and how far off the prediction (4, 4) was."""
        if alignment.brightness > 0:
            self._usual_brightness += (alignment.brightness - self._usual_brightness) * (_USUAL_RATE if self._usual_brightness else 1.0)
        lately = 0.0 if self.expected is None else _DECAY * self.expected
        self.expected = max(_MARGIN * alignment.distance(T_predicted), lately)

    def unexpected(self, alignment: Alignment, T_guess: Tensor, within: float | None) -> bool:
        """Whether a guess that was to be off by `within` [px] turned out to be farther off than the images that were looked at reach."""
        return within is not None and alignment.distance(T_guess) > _OVERSHOOT * max(within, self.config.level_reach)

    def _depth_system(self, surface: Surface, T: Tensor, step: int, normals: _Normals | None) -> tuple[_System, _Normals]:
        """The distances of the points to the map's surface along its normals; the robust scale narrows over the first steps.

        normals: of a step before; none given: those at the points as they lie now.
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
        """The normal equations with the brightness of each reference's landmarks added, on the pyramid's level for this step.

        Also the typical difference of brightness, and the share of the landmarks in view.
        """
        H, b, brightness, seen, in_view, count = system.H, system.b, 0.0, 0, 0, 0
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
            brightness, seen = brightness + term.seen * term.noise, seen + term.seen
        return H, b, brightness / max(seen, 1), in_view / count if count else 1.0

    def compare(self, view: Keyframe, reference: Keyframe, T_wc: Tensor) -> tuple[float, float]:
        """The share of a reference's landmarks that a view at `T_wc` (4, 4) sees, and the typical difference of their brightness."""
        marks, noise, widest = self.landmarks(reference), self.config.colour_noise, self.config.colour_robust
        term = photometric_term(self.appearance(view), marks, reference.T_wk, T_wc, 0, floor=noise, widest=widest)
        return term.seen / max(len(marks.points), 1), term.noise

    def appearance(self, view: Keyframe) -> Appearance:
        """A view's image pyramid, worked out once for as long as its images are in memory."""
        images = view.images
        if images not in self._appearances:
            levels = pyramid(images.colour, view.camera, height=self.config.image_height, levels=self.config.image_levels)
            self._appearances[images] = Appearance(levels, images.depth, view.camera)
        return self._appearances[images]

    def landmarks(self, keyframe: Keyframe) -> Landmarks:
        """A keyframe's landmarks, worked out once; its pyramid is released, since only landmarks are compared with other images."""
        if keyframe not in self._landmarks:
            appearance = self.appearance(keyframe)
            self._landmarks[keyframe] = landmarks(appearance.levels, keyframe.depth, count=self.config.landmarks)
            self.release(keyframe)
        return self._landmarks[keyframe]

    def release(self, view: Keyframe) -> None:
        """Frees a view's image pyramid, which is worked out anew if it is needed again."""
        self._appearances.pop(view.images, None)

    def _judged(
        self, T: Tensor, system: _System, information: Information, brightness: float, in_view: float, iterations: int, focal: float
    ) -> Alignment:
        of_depth = Information.of(system.H, system.weight, system.radius)
        stiffness = float(of_depth.values[0])
        status = Status.OK
        if system.overlap < self.config.min_overlap or system.rmse > self.config.max_rmse:
            status = Status.LOST
        elif stiffness < self.config.min_eigenvalue:
            status = Status.DEGENERATE
        believed = of_depth if brightness > self.doubtful_brightness else information  # images that do not fit know nothing of the motion
        return Alignment(
            se3.orthonormal(T),
            status,
            system.overlap,
            system.rmse,
            stiffness,
            brightness,
            in_view,
            believed,
            iterations,
            focal,
            system.radius,
        )


def plain_surface(depth: Tensor, camera: Camera, jitter: Tensor, patch: int) -> Surface:
    """Of each patch of a depth image (H, W) [m] the pixel that jitter (2, rows, columns) says, if it has depth; in torch, on any device."""
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
    found = numba_alignment.patch_points(depth.numpy(), jitter.numpy(), patch, *intrinsics, *outputs)  # type: ignore[call-arg]
    return Surface(points[:found], noise_ratio(z[:found]), patches)


def damped_step(H: Tensor, b: Tensor, weight: float, radius: float, hold: float, change: Tensor, T: Tensor) -> float:
    """A Gauss-Newton step of normal equations H (6, 6), b (6,), with a prior that holds what they know little of to the guess.

    Moves the pose T (4, 4), and what it has changed since the guess, change (6,), in place; returns the largest entry of the step. All of
    these are on the host, wherever the points are.
    """
    return pick(H, compiled=compiled_damped_step, plain=plain_damped_step)(H, b, weight, radius, hold, change, T)


def compiled_damped_step(H: Tensor, b: Tensor, weight: float, radius: float, hold: float, change: Tensor, T: Tensor) -> float:
    """`damped_step` by Numba, on the CPU."""
    from idfslam.alignment.kernels import numba_alignment

    return float(numba_alignment.damped_step(H.numpy(), b.numpy(), weight, radius, hold, change.numpy(), T.numpy()))  # type: ignore[call-arg]


def plain_damped_step(H: Tensor, b: Tensor, weight: float, radius: float, hold: float, change: Tensor, T: Tensor) -> float:
    """`damped_step` in torch, on any device."""
    P = Information.of(H, weight, radius).prior(hold)
    delta = torch.linalg.solve(H + P, b - P @ change)
    change += delta
    T[:] = moved(T, delta)
    return float(delta.abs().max())


def depth_system(
    turned: Tensor, distance: Tensor, normal: Tensor, slope: Tensor, sigma: Tensor, truncation: float, robust: float, widest: float
) -> _System:
    """Normal equations of the distances (N,) [m] of points to the map, along its normals (N, 3).

    turned (N, 3) [m]: the points from the camera's centre, world axes; slope (N,) of the distance; sigma (N,) the relative noise.
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
    found = numba_alignment.depth_system(*arrays, truncation, robust, widest, H.numpy(), b.numpy())  # type: ignore[call-arg]
    weight, squares, known, radius = found
    return _System(H, b, weight, known / len(distance), (squares / max(weight, 1e-9)) ** 0.5, radius)


def plain_depth_system(
    turned: Tensor, distance: Tensor, normal: Tensor, slope: Tensor, sigma: Tensor, truncation: float, robust: float, widest: float
) -> _System:
    """`depth_system` in torch, on any device."""
    known = (distance.abs() < KNOWN * truncation) & (slope > LEAST_SLOPE)
    r = distance / slope.clamp(min=SLOPE_FLOOR)
    J = torch.cat([normal, torch.linalg.cross(turned, normal)], -1)
    scale = robust * sigma.clamp(max=widest)
    w = known / ((1 + (r / scale) ** 2) ** 2 * sigma**2)  # Geman-McClure, and the sensor's own noise
    JtW = (J * w[:, None]).T
    weight = float(w.sum())
    rmse = (float((w * r * r).sum()) / max(weight, 1e-9)) ** 0.5
    overlap = float(known.float().mean())
    return _System((JtW @ J).double().cpu(), -(JtW @ r).double().cpu(), weight, overlap, rmse, float(turned.norm(dim=-1).mean()))
