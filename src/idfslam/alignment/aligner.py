"""Alignment of a frame to the map: its depth to the zero level of the SDF, its image to those of earlier keyframes.

Gauss-Newton on SE(3) with robust weights, coarse to fine. Depth constrains the pose wherever the map has shape. Where the shape leaves a
direction open (a bare wall), the brightness of the keyframes' landmarks constrains it, and where there are none, their shading. A direction
that nothing constrains keeps its guess.
"""

import math
from collections.abc import Callable, Sequence

import numpy as np
import torch
from torch import Tensor

from idfslam.alignment.alignment import Alignment
from idfslam.alignment.appearances import Appearances
from idfslam.alignment.continuous_motion import MotionPrior
from idfslam.alignment.depth_term import DepthTerm
from idfslam.alignment.displacement import displacement, level_of
from idfslam.alignment.frame_motion import FrameMotion
from idfslam.alignment.gauss_newton import INDEPENDENT, JointSolver, PoseSolver, Solver, information_scale
from idfslam.alignment.image_term import ImageTerm, image_term
from idfslam.alignment.judgement import LastStep, judged, reliable
from idfslam.alignment.motion import Information, change_between, moved
from idfslam.alignment.photometric import photometric_term
from idfslam.alignment.pose_doubt import PoseDoubt
from idfslam.alignment.posed_landmarks import Posed, PosedLandmarks
from idfslam.alignment.row_moments import Array, PoseEquations, RowMoments
from idfslam.alignment.shading import Shading
from idfslam.alignment.sighting import Appearance, Sighting
from idfslam.alignment.small_image import small_image
from idfslam.alignment.surface import Surface, surface_points
from idfslam.alignment.surface_distances import MapQuery, SurfaceDistances
from idfslam.alignment.unknown_delay import DepthAtPose, DisplacedDepth
from idfslam.alignment.usual_error import UsualError
from idfslam.config import AlignmentConfig
from idfslam.frame import Status
from idfslam.geometry.camera import Camera
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_images import Images
from idfslam.storage.state import State, Stateful

# Rows of the image that tells of the sensor's times. More: the times are exacter, and found more slowly if they are long, since slopes
# reach less far. With 120 and 240 rows they are equal on generated recordings; on fr1/rpy they come near the true ones in 180 frames with
# 240, and in 340 with 120.
_TIMING_ROWS = 240
_ALONE = 4  # steps of depth or the images alone to the pose where they fit best. More: slower. Less: their contradiction hides the times
_RIDGE = 1e-3  # [1] of their mean information, added to each direction of these steps. More: they move less where they tell little

# All of these were chosen by hand on generated rooms and redkitchen.

# [1] Bound on the prediction error: `_MARGIN` times the largest recent one, which decays by the factor `_DECAY` a frame.
# More: coarser images are used more often, which is slower and safer.
_MARGIN, _DECAY = 1.5, 0.95
# Every so many points one takes part in the coarse steps. More: faster, and noisier first steps.
_COARSE_STRIDE = 3
# [1] Factor on `robust` in the first step, halved with each step. More: worse guesses are corrected, and more outliers count.
_FIRST_SCALE = 4.0
# [1] An alignment that moves by more than this many times the expected error of its guess has left the reach of its images.
# More: fewer second tries.
_OVERSHOOT = 2.0


class MapAligner(Stateful):
    """Aligns views to a map and to the images of keyframes. Both may change between calls."""

    def __init__(
        self,
        config: AlignmentConfig,
        query: MapQuery,
        truncation: float,
        generator: torch.Generator,
        observed: Callable[[Tensor], Tensor] | None = None,
    ) -> None:
        """query: the map's signed distance. truncation: the map's truncation distance [m]. generator: draws the points.

        observed: says of points (N, 3) [m] in the world whether the map has observed a surface there; None: everywhere.
        """
        self.config, self.query, self.truncation, self.generator, self._observed = config, query, truncation, generator, observed
        self.appearances, self.doubt = Appearances(config), PoseDoubt()
        self.usual_error = UsualError(config.colour_noise, config.doubtful_brightness)
        self.expected: float | None = None  # bound on the error of a prediction [px of the finest image]; None before the first frame

    def state(self) -> State:
        """The usual photometric error, the bound on the prediction error, and the generator."""
        expected = math.inf if self.expected is None else self.expected
        return {"usual_error": self.usual_error.state(), "expected": expected, "generator": self.generator.get_state()}

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        self.usual_error.restore(state["usual_error"])
        self.expected = state["expected"] if math.isfinite(state["expected"]) else None
        self.generator.set_state(state["generator"])

    def align(
        self,
        view: Keyframe,
        T_guess: Tensor,
        references: Sequence[Keyframe],
        *,
        max_guess_error_px: float | None = None,
        registered: bool = False,
        motion: MotionPrior | None = None,
        recent: Posed | None = None,
        displaced_by: Array | None = None,
    ) -> Alignment:
        """Aligns a view to the map and to the images of `references`, starting at `T_guess` (4, 4).

        A view with fewer points of depth than `config.min_points` is aligned to the images alone. It is DEGENERATE, or LOST if they do not
        confirm its pose.
        max_guess_error_px: bound on the error of the guess, in pixels of the finest image. The steps on images too coarse for it are left
        out. None: unknown. registered: the guess comes from the neural tracker and is as exact as the result. It gets a stronger prior in
        the directions that map and images constrain weakly. motion: of a view with a rectification, the images as they were taken are
        used, each row at its own time, and the velocity is estimated too, with this prior for pose and velocity. recent: landmarks of a
        frame shortly before, and its pose (4, 4). They draw the pose as those of references do, and are no evidence for it. displaced_by:
        covariance (6, 6) of where the camera was when it took the depth of a view whose rows have one time; None: at the view's pose.
        """
        moves = motion is not None and view.rectification is not None
        images = view.taken if moves else view.images
        surface = self._observed_surface(images, view.camera, T_guess)
        has_depth = len(surface.points) >= self.config.min_points
        if not has_depth and not any(len(self.appearances.landmarks(reference).points) for reference in references):
            return Alignment(T_guess, Status.LOST, 0.0, float("nan"), 0.0, 0.0, 0.0, None, 0)
        appearance, T = self.appearances.of_images(images, view.camera), T_guess.double().clone()
        prior_information = self.config.registration_prior_information if registered else self.config.prior_information
        solver = self._solver(view, T, motion, prior_information)
        coarse_steps = (self.config.image_levels - 1) * self.config.steps_a_level
        first = min(self._first_step(0.0 if registered else max_guess_error_px), self.config.iterations - 1)
        posed = self._posed(references, recent)
        fine = self._against_map(surface)
        coarse = self._against_map(surface.every(_COARSE_STRIDE)) if has_depth and first < coarse_steps else fine
        if not has_depth:
            depth = self._absent_depth(references, moments=moves)
        taken = DepthAtPose()
        if displaced_by is not None and not moves:
            taken = DisplacedDepth(displaced_by, information_scale(self.config.depth_noise))
        shading: Shading | None = None
        shading_decided, of_shading = registered or not has_depth, PoseEquations(RowMoments.zeros(moments=moves))
        step, steps = first, 0
        while step < self.config.iterations:
            is_coarse, level = step < coarse_steps, self._level(step)
            if has_depth:
                depth = (coarse if is_coarse else fine).term(taken.pose(T), self._robust(step), solver.motion)
            of_images = image_term(appearance, posed, T, level, solver.motion, self.config)
            depth_used = reliable(depth, self.config) if moves and not references else depth
            if not shading_decided and not is_coarse:
                shading_decided, shading = True, self._shading(appearance, references) if self._leaves_open(depth, of_images) else None
            if shading is not None:
                of_shading = self._in_units_of_depth(shading.term(T, moments=moves))
            change, steps = solver.step(taken.marginalised(depth_used), PoseEquations(of_images.sums + of_shading.sums)), steps + 1
            if not is_coarse and np.abs(change).max() < self.config.converged:
                break
            step += 1
        focal, estimate = appearance.levels[0].camera.fx, solver.estimate(depth_used, PoseEquations(of_images.sums + of_shading.sums))
        displaced = self._displacement(appearance, T, references, solver.motion)
        last = LastStep(T, change, depth, of_images, of_shading, displaced, focal, has_depth, estimate, steps)
        return judged(last, self.doubt, self.config)

    def evidence(self, view: Keyframe, T_wc: Tensor, references: Sequence[Keyframe]) -> Alignment:
        """What map and images say of a view at a pose (4, 4) from another source, which is kept."""
        appearance, surface = self.appearances.of(view), self._observed_surface(view.images, view.camera, T_wc)
        has_depth, T, step = len(surface.points) >= self.config.min_points, T_wc.double(), self.config.iterations
        robust = self._robust(step)
        depth = self._against_map(surface).term(T, robust, None) if has_depth else self._absent_depth(references, moments=False)
        images = image_term(appearance, self._posed(references), T, self._level(step), None, self.config)
        displaced, focal = self._displacement(appearance, T, references, None), appearance.levels[0].camera.fx
        nothing = PoseEquations(RowMoments.zeros(moments=False))
        return judged(LastStep(T, np.zeros(6), depth, images, nothing, displaced, focal, has_depth), self.doubt, self.config)

    def _leaves_open(self, depth: DepthTerm, images: ImageTerm) -> bool:
        """Whether depth and landmarks leave a direction to the motion model."""
        return float(Information.of(depth.H + images.H, depth.weight, depth.radius).values[0]) < self.config.prior_information

    def _shading(self, frame: Appearance, references: Sequence[Keyframe]) -> Shading:
        """What tells of such a direction."""
        return Shading(small_image(frame), [(self.appearances.pixels(reference), reference.T_wk) for reference in references])

    def _in_units_of_depth(self, equations: PoseEquations) -> PoseEquations:
        """Equations in units of information, in those of the depth's, of which a share errs independently."""
        return PoseEquations(equations.sums.scaled(self.config.depth_noise**2 / INDEPENDENT))

    def _absent_depth(self, references: Sequence[Keyframe], *, moments: bool) -> DepthTerm:
        """The term of a view without depth: no information, at the landmarks' mean distance. Its small weight makes a weak prior."""
        points = torch.cat([self.appearances.landmarks(reference).points for reference in references]) if references else torch.zeros(0, 3)
        radius = float(points.norm(dim=-1).mean()) if len(points) else 1.0
        return DepthTerm.absent(weight=1.0, radius=radius, moments=moments)

    def _solver(self, view: Keyframe, T: Tensor, motion: MotionPrior | None, prior_information: float) -> Solver:
        if motion is None or view.rectification is None:
            return PoseSolver(T, prior_information)
        return JointSolver(T, motion, view.rectification.times, self.config.depth_noise)

    def _first_step(self, max_guess_error_px: float | None) -> int:
        """The first step for a guess with this largest error: it is at most `level_reach` pixels of the coarsest level used."""
        levels = self.config.image_levels
        if max_guess_error_px is None:
            return 0
        level = math.ceil(math.log2(max(max_guess_error_px / self.config.level_reach, 1.0)))
        return max(0, levels - 1 - level) * self.config.steps_a_level

    def _level(self, step: int) -> int:
        """The level of the pyramid for a step, from the coarsest on."""
        return max(0, self.config.image_levels - 1 - step // self.config.steps_a_level)

    def surface(self, images: Images, camera: Camera) -> Surface:
        """About `config.points` points of a depth image: a random pixel of each of equal patches, if it has depth.

        Patches are smaller if few pixels have depth. A table near the end of the sensor's range may be all there is to align to.
        """
        height, width = images.depth.shape
        patch = max(1, round((images.readings / self.config.points) ** 0.5))
        rows, columns = height // patch, width // patch
        jitter = torch.randint(patch, (2, rows, columns), generator=self.generator)
        return surface_points(images.depth, camera, jitter, patch)

    def _observed_surface(self, images: Images, camera: Camera, T_wc: Tensor) -> Surface:
        """The surface of a frame near a pose (4, 4). Points where the map has observed nothing have no weight."""
        surface, T = self.surface(images, camera), T_wc.float().to(images.depth)
        return surface if self._observed is None else surface.where(self._observed(surface.points @ T[:3, :3].T + T[:3, 3]))

    def row_moments(
        self, view: Keyframe, T_wc: Tensor, references: Sequence[Keyframe], motion: FrameMotion
    ) -> tuple[RowMoments, Callable[[], RowMoments]]:
        """The sums of depth and of images about a pose (4, 4), at a motion, with the moments of the rows, in units of information.

        Both are taken where depth or the images alone fit best, and carried to the pose. Where the times are wrong, they contradict each
        other, and a pose between them is out of reach of the images' slopes and of the robust weights of depth. Those of the images depend
        on nothing that changes: they are worked out when they are called, in this thread or another.
        """
        scale, finest = information_scale(self.config.depth_noise), self.config.iterations
        surface, appearance = self._observed_surface(view.taken, view.camera, T_wc), self.appearances.as_taken(view)
        level = level_of(appearance, _TIMING_ROWS)
        against, robust = self._against_map(surface), self._robust(finest)
        depth = _at_its_best(T_wc, lambda T: against.term(T, robust, motion).sums, self.config.converged)
        posed = self._posed(references)

        def of_images() -> RowMoments:
            best = _at_its_best(T_wc, lambda T: image_term(appearance, posed, T, level, motion, self.config).sums, self.config.converged)
            return best.scaled(scale)

        return depth.scaled(scale), of_images

    def is_doubtful(self, alignment: Alignment) -> bool:
        """Whether another guess should be tried: the view is lost, overlaps little with the map, or the images contradict its pose."""
        return alignment.status is Status.LOST or alignment.overlap < self.config.doubtful_overlap or self.contradicts_images(alignment)

    def contradicts_images(self, alignment: Alignment) -> bool:
        """Whether the image is displaced by much more than usual at the pose (`pose_doubt.PoseDoubt`)."""
        return self.doubt.is_doubtful(alignment.displacement)

    def is_clear(self, alignment: Alignment) -> bool:
        """Whether the image is as alike to those of the keyframes as usual: not blurred, and of the usual brightness."""
        return not self.usual_error.is_known or alignment.photometric_error <= self.usual_error.doubtful

    def displacement(self, view: Keyframe, T_wc: Tensor, references: Sequence[Keyframe]) -> float:
        """The displacement of a view's image at a pose (4, 4) [rad], over the references by their landmarks in view; 0: unknown."""
        return self._displacement(self.appearances.of(view), T_wc, references, None)

    def _displacement(self, frame: Appearance, T_wc: Tensor, references: Sequence[Keyframe], motion: FrameMotion | None) -> float:
        total, count = 0.0, 0
        for reference in references:
            seen, off = displacement(frame, self.appearances.landmarks(reference), reference.T_wk, T_wc, motion)
            if seen >= self.config.min_landmarks:
                total, count = total + seen * off, count + seen
        return total / max(count, 1)

    def accept(self, alignment: Alignment, T_predicted: Tensor) -> None:
        """Updates the usual photometric error and the bound on the error of predictions such as `T_predicted` (4, 4)."""
        self.doubt.accept(alignment.displacement)
        self.usual_error.accept(alignment.photometric_error)
        decayed = 0.0 if self.expected is None else _DECAY * self.expected
        self.expected = max(_MARGIN * alignment.distance(T_predicted), decayed)

    def is_far(self, alignment: Alignment, T_guess: Tensor) -> bool:
        """Whether a pose is farther from its guess (4, 4) than half of the error that the coarsest images correct."""
        reach = self.config.level_reach * 2 ** (self.config.image_levels - 1)
        return alignment.distance(T_guess) > reach / 2

    def unexpected(self, alignment: Alignment, T_guess: Tensor, max_guess_error_px: float | None) -> bool:
        """Whether the pose moved farther from its guess than the images reach that were used for this largest error of the guess."""
        return max_guess_error_px is not None and alignment.distance(T_guess) > _OVERSHOOT * max(
            max_guess_error_px, self.config.level_reach
        )

    def _against_map(self, surface: Surface) -> SurfaceDistances:
        return SurfaceDistances(surface, self.query, self.truncation, self.config.robust_widest)

    def _robust(self, step: int) -> float:
        """[m] the scale of the robust weights of distances. It narrows over the first steps."""
        return self.config.robust * max(1.0, _FIRST_SCALE * 0.5**step)

    def _posed(self, references: Sequence[Keyframe], recent: Posed | None = None) -> PosedLandmarks:
        """The landmarks of the references and of a recent frame."""
        return PosedLandmarks([(self.appearances.landmarks(reference), reference.T_wk) for reference in references], recent)

    def photometric_comparison(self, view: Keyframe, reference: Keyframe, T_wc: Tensor) -> tuple[float, float]:
        """The share of a reference's landmarks that a view at `T_wc` (4, 4) sees, and the scale of their brightness differences."""
        marks, noise, widest = self.appearances.landmarks(reference), self.config.colour_noise, self.config.colour_robust
        term = photometric_term(Sighting(self.appearances.of(view), marks, reference.T_wk, T_wc, 0), floor=noise, widest=widest)
        return term.seen / max(len(marks.points), 1), term.noise


def _at_its_best(T_wc: Tensor, sums_at: Callable[[Tensor], RowMoments], converged: float) -> RowMoments:
    """Sums at the pose near `T_wc` (4, 4) where they are least, carried to `T_wc`. A step below `converged` [m, rad] is not taken."""
    T, sums = T_wc, sums_at(T_wc)
    for _ in range(_ALONE):
        if not sums.H[0].any():
            return sums
        step = np.linalg.solve(sums.H[0] + _RIDGE * np.trace(sums.H[0]) * np.eye(6), sums.b[0])
        if np.abs(step).max() < converged:
            break
        T = moved(T, torch.from_numpy(step))
        sums = sums_at(T)
    return sums.carried(change_between(T_wc, T).numpy())
