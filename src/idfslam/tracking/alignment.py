"""Second-order alignment of a frame to the map: every depth point wants to lie on the zero of the SDF, in its colour.

Gauss-Newton on SE(3) with robust weights, coarse to fine; two more unknowns, gain and offset, take up the camera's
exposure. A weak prior holds the pose to its guess in directions that neither depth nor colour decide.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from idfslam.config import AlignmentConfig
from idfslam.frame import Status
from idfslam.geometry import se3
from idfslam.mapping.field import Field, FieldSample
from idfslam.mapping.fused import sampler
from idfslam.mapping.objectives import noise_ratio
from idfslam.mapping.rays import View


@dataclass(frozen=True)
class Alignment:
    """A pose with its evidence."""

    T_wc: Tensor  # (4, 4) float64
    status: Status
    overlap: float  # share of the points that fall where the map knows the surface
    rmse: float  # [m] of the robustly weighted distances
    stiffness: float  # least information of depth in any direction, per point [1]; small: degenerate
    iterations: int

    @property
    def score(self) -> float:
        """To compare two alignments of one view: much of it explained, and closely."""
        return self.overlap / (self.rmse + 0.005)


MapQuery = Callable[[Tensor], FieldSample]
"""Points (N, 3) [m] in the world -> FieldSample."""


@dataclass(frozen=True)
class Surface:
    """N points of a frame in the camera's frame, with what is known of them."""

    points: Tensor  # (N, 3) [m]
    luminance: Tensor  # (N,)
    sigma: Tensor  # (N,) noise of the depth, relative to the best of the sensor [1]


def align(query: MapQuery, surface: Surface, T_wc: Tensor, truncation: float, config: AlignmentConfig) -> Alignment:
    """Move the guess `T_wc` (4, 4) so that the surface lies on the map.

    `query` answers for the map; `truncation` [m] bounds the distances that it knows.
    """
    T_guess = T = T_wc.double()
    exposure = torch.zeros(2, dtype=torch.float64)
    step = 0
    for step in range(config.iterations):
        scale = config.robust * max(1.0, 4.0 * 0.5**step)
        system = _normal_equations(query, surface, T, exposure, truncation, scale, config)
        H, b = system.H.clone(), system.b.clone()
        prior = torch.diag(torch.tensor(config.prior, dtype=torch.float64)) * max(system.weight, 1e-3)
        H[:6, :6] += prior
        b[:6] -= prior @ _local_difference(T, T_guess)
        delta = torch.linalg.solve(H, b)
        T = _moved(T, delta[:6])
        exposure = exposure + delta[6:]
        if step >= 3 and delta[:3].norm() < config.converged and delta[3:6].norm() < config.converged:
            break
    status = Status.OK
    if system.overlap < config.min_overlap:
        status = Status.LOST
    elif system.stiffness < config.min_stiffness:
        status = Status.DEGENERATE
    return Alignment(se3.orthonormal(T), status, system.overlap, system.rmse, system.stiffness, step + 1)


def _moved(T: Tensor, delta: Tensor) -> Tensor:
    """The pose turned about the camera's own centre by delta[3:] and shifted by delta[:3], both along world axes."""
    out = T.clone()
    out[:3, :3] = se3.exp(torch.cat([torch.zeros_like(delta[:3]), delta[3:]]))[:3, :3] @ T[:3, :3]
    out[:3, 3] = T[:3, 3] + delta[:3]
    return out


def _local_difference(T: Tensor, T_guess: Tensor) -> Tensor:
    """The delta that `_moved` would need to come from T_guess to T."""
    turn = se3.identity_like(T)
    turn[:3, :3] = T[:3, :3] @ T_guess[:3, :3].T
    return torch.cat([T[:3, 3] - T_guess[:3, 3], se3.log(turn)[3:]])


@dataclass(frozen=True)
class _System:
    H: Tensor  # (8, 8) float64
    b: Tensor  # (8,)
    weight: float  # sum of the robust weights
    overlap: float
    rmse: float
    stiffness: float


def _normal_equations(
    query: MapQuery, surface: Surface, T: Tensor, exposure: Tensor, truncation: float, scale: float, config: AlignmentConfig
) -> _System:
    """H delta = b for the pose (shift, turn about the camera) and the exposure (gain, offset)."""
    T32 = T.float()
    turned = surface.points @ T32[:3, :3].T
    sample = query(turned + T32[:3, 3])
    slope = sample.distance_gradient.norm(dim=-1)
    known = (sample.distance.abs() < 0.9 * truncation) & (slope > 0.2)
    normal = sample.distance_gradient / slope.clamp(min=0.2)[:, None]
    r = sample.distance / slope.clamp(min=0.7)
    J = torch.cat([normal, torch.linalg.cross(turned, normal)], -1)
    spread = scale * surface.sigma
    w = known / ((1 + (r / spread) ** 2) ** 2 * surface.sigma**2)  # Geman-McClure, and the sensor's own noise
    H = torch.zeros(8, 8, dtype=torch.float64)
    b = torch.zeros(8, dtype=torch.float64)
    JtW = (J * w[:, None]).T
    H[:6, :6] = JtW @ J
    b[:6] = -(JtW @ r)
    radius = turned.norm(dim=-1).mean().clamp(min=0.1)
    unit = torch.cat([torch.ones(3), torch.ones(3) / radius]).double()
    stiffness = float(torch.linalg.eigvalsh(H[:6, :6] * unit[:, None] * unit)[0] / max(float(w.sum()), 1e-9))
    if config.colour_weight > 0:
        gain, offset = (float(e) for e in exposure)
        rc = (1 + gain) * surface.luminance + offset - sample.luminance
        Jc = torch.cat([-sample.luminance_gradient, torch.linalg.cross(turned, -sample.luminance_gradient)], -1)
        Jc = torch.cat([Jc, surface.luminance[:, None], torch.ones_like(rc)[:, None]], -1)
        near = known & (sample.distance.abs() < 0.5 * truncation)
        wc = near * config.colour_weight**2 / ((1 + (rc / config.colour_robust) ** 2) ** 2 * surface.sigma**2)
        JtWc = (Jc * wc[:, None]).T
        H += JtWc @ Jc
        b -= JtWc @ rc
        H[6, 6] += 1e-2 * wc.sum()  # a gain is rare
    H[6:, 6:] += 1e-9 * torch.eye(2)
    count = int(known.sum())
    rmse = float(((w * r * r).sum() / w.sum().clamp(min=1e-9)).sqrt())
    return _System(H, b, float(w.sum()), count / max(len(r), 1), rmse, stiffness)


class Aligner:
    """Aligns views to a field; the field may change between calls."""

    def __init__(self, config: AlignmentConfig, field: Field, generator: torch.Generator) -> None:
        self.config, self.field, self._generator = config, field, generator
        self.query = sampler(field)

    def surface(self, view: View) -> Surface:
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
        points = view.frame.camera.rays(torch.stack([u, v], -1).to(depth.dtype)) * depth[:, None]
        return Surface(points, view.colour[v, u].mean(-1), noise_ratio(depth))

    def align(self, view: View, T_guess: Tensor) -> Alignment:
        """The view's pose near `T_guess` (4, 4); LOST if it has no depth."""
        surface = self.surface(view)
        if len(surface.points) < self.config.min_points:
            return Alignment(T_guess, Status.LOST, 0.0, float("nan"), 0.0, 0)
        return align(self.query, surface, T_guess, self.field.config.truncation, self.config)

    def doubtful(self, alignment: Alignment) -> bool:
        """Whether another guess is worth its time: little overlap, or distances as wide as the robust kernel."""
        return alignment.overlap < self.config.doubtful_overlap or alignment.rmse > self.config.robust
