"""Second-order alignment of a frame to the map: depth on the zero of the SDF, images on those of earlier keyframes.

Gauss-Newton on SE(3) with robust weights, coarse to fine. Depth holds the frame to everything mapped so far; where the map's
shape leaves a direction open (a bare wall) the brightness of keyframes' landmarks decides, and what neither decides stays at the guess.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from idfslam.config import AlignmentConfig
from idfslam.frame import Status
from idfslam.geometry import se3
from idfslam.graph.keyframes import Keyframe
from idfslam.mapping.field import Field
from idfslam.mapping.fused import distance_query
from idfslam.mapping.objectives import noise_ratio
from idfslam.tracking.photometric import Appearance, Landmarks, landmarks, photometric_term, pyramid


@dataclass(frozen=True)
class Alignment:
    """A pose with its evidence."""

    T_wc: Tensor  # (4, 4) float64
    status: Status
    overlap: float  # share of the points that fall where the map knows the surface
    rmse: float  # [m] of the robustly weighted distances
    stiffness: float  # least information of depth in any direction, per unit weight [1]; small: degenerate
    brightness: float  # typical difference of brightness to the references' landmarks in view, 0 without any
    iterations: int

    @property
    def score(self) -> float:
        """To compare two alignments of one view: much of it explained, closely, and in its colours; 0 if lost."""
        return 0.0 if self.status is Status.LOST else self.overlap / ((self.rmse + 0.003) * (self.brightness + 0.005))


@dataclass(frozen=True)
class Surface:
    """N points of a frame in the camera's frame."""

    points: Tensor  # (N, 3) [m]
    sigma: Tensor  # (N,) noise of the depth, relative to the best of the sensor [1]


@dataclass(frozen=True)
class _System:
    """Normal equations H delta = b of a pose: shift, and turn about the camera's own centre, both along world axes."""

    H: Tensor  # (6, 6) float64
    b: Tensor  # (6,)
    weight: float  # sum of the robust weights
    overlap: float
    rmse: float
    radius: float  # mean distance of the points [m], to compare a turn with a shift


MapQuery = Callable[[Tensor], tuple[Tensor, Tensor]]
"""Points (N, 3) [m] in the world -> signed distance (N,) [m] and its gradient (N, 3)."""


class Aligner:
    """Aligns views to a field and to the images of keyframes; both may change between calls."""

    def __init__(self, config: AlignmentConfig, field: Field, generator: torch.Generator) -> None:
        self.config, self._generator = config, generator
        self._usual_brightness = 0.0
        self.truncation = field.config.truncation
        self.query: MapQuery = distance_query(field)

    def align(self, view: Keyframe, T_guess: Tensor, references: Sequence[Keyframe]) -> Alignment:
        """The view's pose near `T_guess` (4, 4), held to the map and to the images of `references`; LOST if it has no depth."""
        surface = self.surface(view)
        if len(surface.points) < self.config.min_points:
            return Alignment(T_guess, Status.LOST, 0.0, float("nan"), 0.0, 0.0, 0)
        T, moved = T_guess.double(), torch.zeros(6, dtype=torch.float64)
        coarse_steps = (self.config.image_levels - 1) * self.config.steps_a_level
        coarse = Surface(surface.points[::3].contiguous(), surface.sigma[::3].contiguous())
        for step in range(self.config.iterations):
            system = self._depth_system(coarse if step < coarse_steps else surface, T, step)
            H, b, brightness = self._with_images(system, view, references, T, step)
            prior = self.config.prior * max(system.weight, 1e-3)
            delta = torch.linalg.solve(H + prior * torch.eye(6, dtype=torch.float64), b - prior * moved)
            T, moved = _moved(T, delta), moved + delta
            if step >= coarse_steps and float(delta.abs().max()) < self.config.converged:
                break
        return self._judged(T, system, brightness, step + 1)

    def surface(self, view: Keyframe) -> Surface:
        """Points of a view, one in each of about `config.points` equal patches, at random within it; patches without depth give none."""
        height, width = view.depth.shape
        patch = max(1, round((height * width / self.config.points) ** 0.5))
        rows, columns = height // patch, width // patch
        jitter = torch.randint(patch, (2, rows, columns), generator=self._generator)
        v = (torch.arange(rows)[:, None] * patch + jitter[0]).flatten().to(view.depth.device)
        u = (torch.arange(columns)[None] * patch + jitter[1]).flatten().to(view.depth.device)
        depth = view.depth[v, u]
        keep = depth > 0
        v, u, depth = v[keep], u[keep], depth[keep]
        return Surface(view.frame.camera.rays(torch.stack([u, v], -1).to(depth.dtype)) * depth[:, None], noise_ratio(depth))

    def doubtful(self, alignment: Alignment) -> bool:
        """Whether another guess is worth its time: lost, little overlap, or colours that fit much worse than they lately did."""
        usual = max(self._usual_brightness, self.config.colour_noise)
        return (
            alignment.status is Status.LOST
            or alignment.overlap < self.config.doubtful_overlap
            or alignment.brightness > self.config.doubtful_brightness * usual
        )

    def accept(self, alignment: Alignment) -> None:
        """Remember how well colours fit, as a slow running mean."""
        if alignment.brightness > 0:
            self._usual_brightness += (alignment.brightness - self._usual_brightness) * (0.1 if self._usual_brightness else 1.0)

    def _depth_system(self, surface: Surface, T: Tensor, step: int) -> _System:
        """The distances of the points to the map's surface along its normals; the robust scale narrows over the first steps."""
        T32 = T.float().to(surface.points)
        turned = surface.points @ T32[:3, :3].T
        distance, gradient = self.query(turned + T32[:3, 3])
        robust = self.config.robust * max(1.0, 4.0 * 0.5**step)
        build = depth_system if turned.device.type == "cpu" else plain_depth_system
        return build(turned, distance, gradient, surface.sigma, self.truncation, robust, self.config.robust_widest)

    def _with_images(
        self, system: _System, view: Keyframe, references: Sequence[Keyframe], T: Tensor, step: int
    ) -> tuple[Tensor, Tensor, float]:
        """The normal equations with the brightness of each reference's landmarks added, on the pyramid's level for this step."""
        H, b, brightness, seen = system.H, system.b, 0.0, 0
        frame = self.appearance(view)
        level = max(0, self.config.image_levels - 1 - step // self.config.steps_a_level)
        for reference in references:
            marks = self.landmarks(reference)
            noise, widest = self.config.colour_noise, self.config.colour_robust
            term = photometric_term(frame, marks, reference.T_wk, T, level, floor=noise, widest=widest)
            H = H + self.config.depth_noise**2 * term.H
            b = b + self.config.depth_noise**2 * term.b
            brightness, seen = brightness + term.seen * term.noise, seen + term.seen
        return H, b, brightness / max(seen, 1)

    def appearance(self, view: Keyframe) -> Appearance:
        """A view's image pyramid, worked out once."""
        if view.appearance is None:
            levels = pyramid(view.colour, view.frame.camera, height=self.config.image_height, levels=self.config.image_levels)
            view.appearance = Appearance(levels, view.depth, view.frame.camera)
        return view.appearance

    def landmarks(self, keyframe: Keyframe) -> Landmarks:
        """A keyframe's landmarks, worked out once; its pyramid is let go, since only landmarks are held against others."""
        if keyframe.landmarks is None:
            keyframe.landmarks = landmarks(self.appearance(keyframe).levels, keyframe.depth, count=self.config.landmarks)
            keyframe.appearance = None
        return keyframe.landmarks

    def _judged(self, T: Tensor, system: _System, brightness: float, iterations: int) -> Alignment:
        unit = torch.tensor([1.0] * 3 + [1 / max(system.radius, 0.1)] * 3, dtype=torch.float64)
        stiffness = float(torch.linalg.eigvalsh(system.H * unit[:, None] * unit)[0]) / max(system.weight, 1e-9)
        status = Status.OK
        if system.overlap < self.config.min_overlap or system.rmse > self.config.max_rmse:
            status = Status.LOST
        elif stiffness < self.config.min_stiffness:
            status = Status.DEGENERATE
        return Alignment(se3.orthonormal(T), status, system.overlap, system.rmse, stiffness, brightness, iterations)


def depth_system(
    turned: Tensor, distance: Tensor, gradient: Tensor, sigma: Tensor, truncation: float, robust: float, widest: float
) -> _System:
    """`plain_depth_system` by Numba, on the CPU."""
    from idfslam.mapping.kernels import numba_alignment

    H, b = torch.zeros(6, 6, dtype=torch.float64), torch.zeros(6, dtype=torch.float64)
    arrays = [t.numpy() for t in (turned, distance, gradient, sigma)]
    weight, squares, known = numba_alignment.depth_system(*arrays, truncation, robust, widest, H.numpy(), b.numpy())  # type: ignore[call-arg]
    radius = float(turned.norm(dim=-1).mean())
    return _System(H, b, weight, known / len(distance), (squares / max(weight, 1e-9)) ** 0.5, radius)


def plain_depth_system(
    turned: Tensor, distance: Tensor, gradient: Tensor, sigma: Tensor, truncation: float, robust: float, widest: float
) -> _System:
    """Normal equations of the distances (N,) [m] of points to the map, along its normals; in torch, on any device.

    turned (N, 3) [m]: the points from the camera's centre, world axes; gradient (N, 3) of the distance; sigma (N,) the relative noise.
    """
    slope = gradient.norm(dim=-1)
    known = (distance.abs() < 0.9 * truncation) & (slope > 0.2)
    normal = gradient / slope.clamp(min=0.2)[:, None]
    r = distance / slope.clamp(min=0.7)
    J = torch.cat([normal, torch.linalg.cross(turned, normal)], -1)
    scale = robust * sigma.clamp(max=widest)
    w = known / ((1 + (r / scale) ** 2) ** 2 * sigma**2)  # Geman-McClure, and the sensor's own noise
    JtW = (J * w[:, None]).T
    weight = float(w.sum())
    rmse = (float((w * r * r).sum()) / max(weight, 1e-9)) ** 0.5
    overlap = float(known.float().mean())
    return _System((JtW @ J).double().cpu(), -(JtW @ r).double().cpu(), weight, overlap, rmse, float(turned.norm(dim=-1).mean()))


def _moved(T: Tensor, delta: Tensor) -> Tensor:
    """The pose turned about the camera's own centre by delta[3:] and shifted by delta[:3], both along world axes."""
    out = T.clone()
    out[:3, :3] = se3.exp(torch.cat([torch.zeros_like(delta[:3]), delta[3:]]))[:3, :3] @ T[:3, :3]
    out[:3, 3] = T[:3, 3] + delta[:3]
    return out
