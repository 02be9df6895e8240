"""What a self-calibration found, in plain words: value by value, and what is off by so much that it matters."""

import math
from dataclasses import dataclass, replace

import numpy as np

from idfslam.adjustment.camera_model import NAMES, CameraModel
from idfslam.adjustment.self_calibration import CameraEstimate, fitting

# [standard deviations] from which on a value counts as off; raised, fewer doubts are told. Deviations are estimates themselves: chance
# brings a right value so far once in 10 000 times (Student's t with 14 degrees of freedom: two estimates from eight stretches)
_CERTAIN = 5.4
# Deviations from which on a camera harms: raised, fewer doubts are told. In generated rooms, 1 % of focal length and 3 px of the centre (at
# a width of 640) together quadruple the error of the trajectory
_FOCAL = 0.005  # [1]
_CENTRE = 0.004  # [1] of the width: 2.6 px of 640; likewise
_EDGE = 0.006  # [1] of the width, by which distortion moves the corner of the image: 4 px of 640; likewise
_DEPTH = 0.02  # [1] of readings in the image's corner, or at 4 m, against those in its middle or at 2 m; at 0.01 a right camera with
#    a rolling shutter was doubted for 0.014
_FAR = 4.0  # [m] where a deformation with range is told; raised, it reads as larger: it grows with depth


@dataclass(frozen=True)
class Finding:
    """One property of a camera."""

    name: str
    found: str  # value and standard deviation, or that it is not determined
    meaning: str  # what it changes, in plain words
    doubt: str = ""  # what is wrong with the stated value; empty if it is right, or wrong by so little that it does not matter


def findings(estimate: CameraEstimate) -> list[Finding]:
    """What was found of each property."""
    of_each = [_focal(estimate), _centre(estimate), _distortion(estimate), _scale(estimate), _deformation(estimate)]
    right = fitting(estimate)
    return [
        replace(finding, meaning="as stated, as far as the views tell: it stays", doubt="") if finding.name in right else finding
        for finding in of_each
    ]


def doubts(estimate: CameraEstimate) -> list[str]:
    """What is wrong with the stated camera by so much that it matters; the worst first."""
    return [finding.doubt for finding in findings(estimate) if finding.doubt]


def _of(estimate: CameraEstimate, name: str) -> tuple[float, float]:
    """Value and standard deviation; 0 if it is not determined."""
    i = NAMES.index(name)
    return float(estimate.model.values[i]), float(estimate.sigmas[i])


def _off(value: float, sigma: float, matters: float) -> bool:
    return sigma > 0 and abs(value) > max(_CERTAIN * sigma, matters)


def _focal(estimate: CameraEstimate) -> Finding:
    c, stated = estimate.model.camera, estimate.model.stated
    (focal, sigma), (_, of_aspect) = _of(estimate, "focal"), _of(estimate, "aspect")
    if not sigma:
        return Finding("focal length", "not determined", "the views do not tell it: turn the camera more, and move it")
    excess = 1 / (1 + focal) - 1  # of what is stated
    spread = c.fx * sigma, c.fy * math.hypot(sigma, of_aspect)
    found = f"fx {c.fx:.2f} ± {spread[0]:.2f}, fy {c.fy:.2f} ± {spread[1]:.2f} px"
    word = "long" if excess > 0 else "short"
    meaning = f"stated {stated.fx:.2f} {stated.fy:.2f}, {_percent(excess)} too {word}: objects look {'narrower' if excess > 0 else 'wider'}"
    return Finding("focal length", found, meaning, f"the focal length looks {_percent(excess)} too {word}" * _off(focal, sigma, _FOCAL))


def _centre(estimate: CameraEstimate) -> Finding:
    c, stated, width = estimate.model.camera, estimate.model.stated, estimate.model.stated.width
    values = [_of(estimate, name) for name in ("cx", "cy")]
    if not all(sigma for _, sigma in values):
        return Finding("principal point", "not determined", "the views do not tell it: turn the camera about its viewing axis too")
    found = f"cx {c.cx:.2f} ± {values[0][1] * width:.2f}, cy {c.cy:.2f} ± {values[1][1] * width:.2f} px"
    shift = c.cx - stated.cx, c.cy - stated.cy
    turned = math.degrees(math.hypot(*shift) / c.fx)
    meaning = f"stated {stated.cx:.2f} {stated.cy:.2f}: the viewing direction is {turned:.2f} degrees from where it was taken to be"
    off = any(_off(value, sigma, _CENTRE) for value, sigma in values)
    return Finding("principal point", found, meaning, f"the principal point looks {math.hypot(*shift):.1f} px off" * off)


def _distortion(estimate: CameraEstimate) -> Finding:
    (k1, s1), (k2, s2) = (_of(estimate, name) for name in ("k1", "k2"))
    if not s1 and not s2:
        return Finding("distortion", "not determined", "the views do not tell it: let objects pass the image's corners")
    moved = _corner(estimate.model)
    found = ", ".join(f"{name} {k:+.4f} ± {s:.4f}" for name, k, s in (("k1", k1, s1), ("k2", k2, s2)) if s)
    meaning = f"moves the image's corners by {abs(moved):.1f} px {'outwards' if moved > 0 else 'inwards'}"
    off = abs(moved) > _EDGE * estimate.model.stated.width and any(s and abs(k) > _CERTAIN * s for k, s in ((k1, s1), (k2, s2)))
    return Finding("distortion", found, meaning, f"the lens looks distorted by {abs(moved):.1f} px in the image's corners" * off)


def _corner(model: CameraModel) -> float:
    """[px] by which distortion moves the farthest corner of the image outwards."""
    c, (k1, k2) = model.camera, model.distortion
    r2 = (max(c.cx, c.width - 1 - c.cx) / c.fx) ** 2 + (max(c.cy, c.height - 1 - c.cy) / c.fy) ** 2
    return math.sqrt(r2) * r2 * (k1 + k2 * r2) * c.fx


def _scale(estimate: CameraEstimate) -> Finding:
    value, sigma = _of(estimate, "depth_scale")
    if not sigma:
        told = "images and depth of a moving camera fit together at any scale: true poses (--truth) would tell it"
        return Finding("depth scale", "not determined", told)
    factor = estimate.model.depth_factor
    excess = 1 / factor - 1
    word = "long" if excess > 0 else "short"
    meaning = f"readings are {_percent(excess)} too {word}"
    off = f"the depth scale looks wrong: readings are {_percent(excess)} too {word}" * _off(value, sigma, _DEPTH)
    return Finding("depth scale", f"readings times {factor:.4f} ± {sigma:.4f}", meaning, off)


def _deformation(estimate: CameraEstimate) -> Finding:
    d = estimate.model.deformation
    sigmas = estimate.sigmas[NAMES.index("depth_scale") + 1 :]
    if not sigmas.any():
        return Finding(
            "depth over range and image", "not determined", "the views do not tell it: see the same places from near and from afar"
        )
    far = -d.range * (_FAR / 2 - 1)
    corners = [-(x * d.across + y * d.along + d.across2 + d.along2) for x in (-1, 1) for y in (-1, 1)]
    corner = max(corners, key=abs)
    meaning = f"readings at {_FAR:g} m are {_signed(far)} against those at 2 m, in a corner {_signed(corner)} against the middle"
    certain = bool((np.abs(estimate.model.values[-len(sigmas) :]) > _CERTAIN * sigmas)[sigmas > 0].any())
    off = certain and max(abs(far), abs(corner)) > _DEPTH
    found = ", ".join(f"{name} {value:+.4f} ± {sigma:.4f}" for name, value, sigma in zip(NAMES[-5:], vars(d).values(), sigmas) if sigma)
    return Finding("depth over range and image", found, meaning, f"depth looks warped by {_percent(max(far, corner, key=abs))}" * off)


def _percent(share: float) -> str:
    return f"{100 * abs(share):.1f} %"


def _signed(share: float) -> str:
    return f"{_percent(share)} too {'long' if share > 0 else 'short'}"
