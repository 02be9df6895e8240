"""Direct photometric alignment: landmarks of a keyframe have the same brightness in the frame.

The images of earlier keyframes constrain directions that the shape of the map leaves open (along a bare wall), to a fraction of a pixel.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from idfslam.alignment.constants import DEVIATION, NEAREST
from idfslam.alignment.exposure import exposure
from idfslam.alignment.row_moments import PoseEquations, RowMoments
from idfslam.alignment.sighting import Sighting
from idfslam.alignment.uneven_light import plain_relit
from idfslam.compute.backend import pick


@dataclass(frozen=True)
class Term(PoseEquations):
    """The equations of the brightness of one keyframe's landmarks."""

    seen: int  # landmarks in view
    noise: float  # scale of the brightness differences [1]


def photometric_term(sighting: Sighting, *, floor: float, widest: float, even: bool = False, moments: bool = False) -> Term:
    """Normal equations of the brightness differences of a keyframe's landmarks in a frame, after exposure and light are compensated.

    Differences are divided by their own scale, so that sharp, well-registered images count more than blurred ones. The scale comes from
    their median and is at least `floor` [1]. The robust kernel has a width of `widest` scales.
    even: whether light has changed everywhere alike. moments: whether the sums have the moments of the rows.
    """
    term = pick(sighting.marks.points, compiled=compiled_photometric_term, plain=plain_photometric_term)
    return term(sighting, floor=floor, widest=widest, even=even, moments=moments)


def compiled_photometric_term(sighting: Sighting, *, floor: float, widest: float, even: bool = False, moments: bool = False) -> Term:
    """`photometric_term` by Numba, on the CPU."""
    from idfslam.alignment.kernels.numba_landmarks import photometric_system

    sums, marks = RowMoments.zeros(moments=moments), sighting.marks
    landmarks = marks.points.numpy(), marks.luminance[sighting.level].numpy()
    seen, noise = photometric_system(*landmarks, *sighting.numbers(), floor, widest, even, sums.H, sums.b)  # type: ignore[call-arg]
    return Term(sums, seen, noise)


def plain_photometric_term(sighting: Sighting, *, floor: float, widest: float, even: bool = False, moments: bool = False) -> Term:
    """`photometric_term` in torch, on any device."""
    image, target, places = sighting.image, sighting.marks.luminance[sighting.level], sighting.places()
    T_wc, uv, z = sighting.T_wc.to(target), places.uv, places.z
    value, slope_u, slope_v = image.at(uv)
    inside = places.within & places.in_sight
    if even:
        gain, offset = exposure(target, value, inside)
        r = value - gain * target - offset
    else:
        seen = (x[inside] for x in (target, value, slope_u, slope_v, sighting.shares(uv)))
        r = torch.zeros_like(value).masked_scatter(inside, plain_relit(*seen).difference)
    scale = _median(r.abs()[inside]).mul(DEVIATION).clamp(min=floor)
    w = inside / ((1 + (r / (widest * scale)) ** 2) ** 2 * scale**2)
    # dr = -slope . dpi/dp . R^T (shift + turn x d)
    fx, fy = image.camera.fx, image.camera.fy
    x, y, _ = places.camera.unbind(-1)
    z = z.clamp(min=NEAREST)
    a = torch.stack([slope_u * fx / z, slope_v * fy / z, -(slope_u * fx * x + slope_v * fy * y) / z**2], -1)
    n = -(a @ T_wc[:3, :3].T)
    J = torch.cat([n, torch.linalg.cross(places.d, n)], -1)
    rows = (uv[:, 1] + 0.5) / image.camera.height - 0.5 if moments else None
    return Term(RowMoments.of(J, w, r, rows), int(inside.sum()), float(scale))


def _median(values: Tensor) -> Tensor:
    """The median, as numpy computes it: the middle two are averaged. 0 for no values."""
    return values.quantile(0.5) if len(values) else values.new_zeros(())
