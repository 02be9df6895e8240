"""The shading of a bare wall as a measurement of the directions that depth and landmarks leave open.

A bare wall has no landmarks, yet hardly any is evenly bright: light falls off along it. In one pixel that is less than the noise. Over all
pixels of a small image it tells a shift to a millimetre or two, against any keyframe that shows the wall (direct alignment with all pixels:
Comport, Malis and Rives 2007). Two things would pass for such a measurement. A change of exposure looks like a shift along an even slope
of brightness, so gain and offset are eliminated with the pose. And noise has slopes too: the information that these alone would give is
taken out, direction by direction, so an even wall measures nothing.
"""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from idfslam.alignment.constants import DEVIATION, NEAREST
from idfslam.alignment.exposure import exposure
from idfslam.alignment.landmarks import Landmarks
from idfslam.alignment.motion import change_between
from idfslam.alignment.row_moments import Array, PoseEquations, RowMoments
from idfslam.alignment.sighting import Appearance, Sighting

# All of these were chosen by hand on generated rooms with a bare wall.
_LEAST_SEEN = 300  # [pixels] of a keyframe's small image, a quarter of it, that the frame shows too. More: keyframes count less long
_NOISE = 5e-4  # [1] Least scale of brightness differences: a tenth of a step of 8 bits, averaged over 64 pixels. More: shading counts less
_ROBUST = 3.0  # [1] Width of the robust kernel in scales. More: outliers count more
# [1] Information of the slopes of noise, as a share of that of slopes as steep as brightness differs, for each axis of the image. Each of
# two images has half of the differences' variance, and a central difference has half of a pixel's: a fact, not a choice. Twice of it is
# taken out, since it varies.
_BY_NOISE = 2 * 0.25
_RIDGE = 1e-9  # [1] of each coordinate's information, added to it, so that no direction is without any. More: nothing
# [m], [rad] Change of a pose within which brightness is taken to be linear: a twentieth of a pixel of 30 rows. More: faster, less exact.
_LINEAR = 2e-3
_INDEPENDENT = 0.25  # [1] Share of the pixels that err independently: exposure and highlights err together. More: shading counts more


class Shading:
    """A frame's small image, compared with those of keyframes."""

    def __init__(self, small: Appearance, posed: Sequence[tuple[Landmarks, Tensor]]) -> None:
        """posed: the pixels of each keyframe's small image (`pixels_of`), and its pose (4, 4) float64."""
        self.small, self.posed = small, posed
        self._known: tuple[Tensor, RowMoments] | None = None  # the last pose that was evaluated, and the sums about it

    def term(self, T_wc: Tensor, *, moments: bool) -> PoseEquations:
        """Normal equations about a pose (4, 4) float64, in units of information [1/m^2], [1/rad^2].

        moments: whether the sums have room for the moments of the rows. These are zero: all rows count as those of the middle.
        """
        change = np.full(6, np.inf) if self._known is None else change_between(T_wc, self._known[0]).numpy()
        if self._known is None or np.abs(change).max() > _LINEAR:
            self._known, change = (T_wc.clone(), self._sums(T_wc, moments=moments)), np.zeros(6)
        return PoseEquations(self._known[1].carried(change))

    def _sums(self, T_wc: Tensor, *, moments: bool) -> RowMoments:
        sums = RowMoments.zeros(moments=moments)
        for pixels, T_wk in self.posed:
            H, b = _equations(Sighting(self.small, pixels, T_wk, T_wc, len(self.small.levels) - 1))
            sums.H[0] += _INDEPENDENT * H
            sums.b[0] += _INDEPENDENT * b
        return sums


def _equations(sighting: Sighting) -> tuple[Array, Array]:
    """H (6, 6) and b (6,) of one keyframe; zero where too little of it is in view."""
    image, target, places = sighting.image, sighting.marks.luminance[sighting.level], sighting.places()
    inside = places.within & places.in_sight
    if int(inside.sum()) < _LEAST_SEEN:
        return np.zeros((6, 6)), np.zeros(6)
    value, *slopes = image.at(places.uv[inside]).double()
    target, along_u, along_v = target[inside].double(), *_jacobians(sighting, places.camera[inside].double(), places.d[inside].double())
    gain, offset = exposure(target, value, torch.ones_like(target))
    r = value - gain * target - offset
    scale = r.abs().quantile(0.5).mul(DEVIATION).clamp(min=_NOISE)
    w = 1 / ((1 + (r / (_ROBUST * scale)) ** 2) ** 2 * scale**2)
    J, r = _without_exposure(slopes[0][:, None] * along_u + slopes[1][:, None] * along_v, r, w, target)
    sums = RowMoments.of(J, w, r, None)
    of_u, of_v = (RowMoments.of(along, w * scale**2, r, None).H[0] for along in (along_u, along_v))
    return _reliable(sums.H[0], sums.b[0], _BY_NOISE * (of_u + of_v))


def _jacobians(sighting: Sighting, points: Tensor, d: Tensor) -> tuple[Tensor, Tensor]:
    """(N, 6) each: derivatives by the pose of the places u and v [px] of points (N, 3) along the camera's axes; d: along the world's."""
    camera, R = sighting.image.camera, sighting.T_wc[:3, :3].to(points)
    x, y, z = points.unbind(-1)
    z, zero = z.clamp(min=NEAREST), torch.zeros_like(z)
    of_u = torch.stack([camera.fx / z, zero, -camera.fx * x / z**2], -1)
    of_v = torch.stack([zero, camera.fy / z, -camera.fy * y / z**2], -1)
    n_u, n_v = -of_u @ R.T, -of_v @ R.T
    return torch.cat([n_u, torch.linalg.cross(d, n_u)], -1), torch.cat([n_v, torch.linalg.cross(d, n_v)], -1)


def _without_exposure(J: Tensor, r: Tensor, w: Tensor, target: Tensor) -> tuple[Tensor, Tensor]:
    """J (N, 6) and r (N,) less what a change of gain and offset explains of them, so that the pose is solved together with these."""
    A, columns = torch.stack([target - target.mean(), torch.ones_like(target)], -1), torch.cat([J, r[:, None]], -1)
    left = columns - A @ torch.linalg.lstsq(A * w[:, None].sqrt(), columns * w[:, None].sqrt()).solution
    return left[:, :6], left[:, 6]


def _reliable(H: Array, b: Array, by_noise: Array) -> tuple[Array, Array]:
    """H (6, 6) and b (6,) less the share of each direction's information that noise alone would give, by_noise (6, 6)."""
    L = np.linalg.cholesky(H + np.diag(_RIDGE * (np.diag(H) + 1)))
    inverse = np.linalg.inv(L)
    values, directions = np.linalg.eigh(inverse @ by_noise @ inverse.T)
    turned, share = L @ directions, (1 - values).clip(min=0)
    return (turned * share) @ turned.T, (turned * share) @ (directions.T @ (inverse @ b))
