"""Vignetting and exposures of a recording that agree best with all comparisons of its images."""

from collections.abc import Sequence

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.linalg import spsolve

from idfslam.sensing.light_comparison import OFFSET, Comparison, Floats, prior
from idfslam.sensing.vignette import TERMS, Vignette

_LEAST_PAIRS = 10  # pairs of images from which the scatter of their answers says something; more: vignetting counts later. By hand
_CORNER = 0.02  # [1] largest standard deviation of the light at the corner; more: vignetting counts sooner, less sure. Chosen by hand
_SIGNIFICANT = 30.0  # [1] least squared size of the vignetting in its standard deviations (chi-square of TERMS unknowns: 1 in 3 million).
#    More: slight vignetting is not seen. High, because errors of shape and reflections are alike in all pairs
_SLIGHT = 0.01  # [1] change of the light up to which vignetting counts as none; more: slight vignetting stays. Chosen by hand
_CHANGE = 0.005  # [1] change of a medium grey between two images, as the root of the mean square, from which a camera counts as one that
#    changes its exposure; more: slow changes are not seen. Three times that of exact generated images of one exposure
_MEDIUM = 0.4  # [1] colour of a medium grey; more: offsets count less against gains. Chosen by hand
_GAIN = 1.0  # [1] standard deviation of the logarithm of a gain before anything is seen; more: the prior draws less towards 1. By hand
_RADII = np.linspace(0, 1, 11)[:, None] ** (2 * np.arange(1, TERMS + 1))  # (11, TERMS) even powers of radii: a fact, not a choice
_EXPOSURE = slice(0, 2)  # of a comparison's unknowns: those of the exposures
_LENS = slice(2, 2 + TERMS)  # those of the vignette


def vignette(comparisons: Sequence[Comparison]) -> Vignette | None:
    """The vignetting that the comparisons agree on; None if it is not sure, or not surely there.

    Each pair answers for itself, with its own exposures. Its standard deviation is the scatter of the answers, so what errs in a pair as a
    whole (its pose, a reflection) counts once.
    """
    if len(comparisons) < _LEAST_PAIRS:
        return None
    information, right = (np.stack(parts) for parts in zip(*map(_without_exposures, comparisons)))  # (P, TERMS, TERMS), (P, TERMS)
    inverse = np.linalg.inv(information.sum(0) + np.diag(prior()[_LENS]))
    coefficients = inverse @ right.sum(0)
    pulls = right - information @ coefficients  # (P, TERMS)
    covariance = inverse @ (pulls.T @ pulls) @ inverse * len(pulls) / (len(pulls) - TERMS)
    corner = float(covariance.sum()) ** 0.5  # of the logarithm of the light at radius 1, the sum of the coefficients
    size = float(coefficients @ np.linalg.solve(covariance, coefficients))
    found = Vignette(tuple(coefficients.tolist()))
    return found if corner < _CORNER and size > _SIGNIFICANT and differ(found, None) else None


def differ(a: Vignette | None, b: Vignette | None) -> bool:
    """Whether two vignettings (None: none) differ noticeably somewhere."""
    none = Vignette()
    change = np.subtract((a or none).coefficients, (b or none).coefficients)
    return float(np.abs(_RADII @ change).max()) > _SLIGHT


def _without_exposures(comparison: Comparison) -> tuple[Floats, Floats]:
    """The information (TERMS, TERMS) of a pair about the vignette, and its right side (TERMS,), whatever the exposures are."""
    N, r = comparison.normal, comparison.right
    inner = N[:, _EXPOSURE, _EXPOSURE] + np.diag(prior()[_EXPOSURE])
    carried = np.linalg.solve(inner, N[:, _EXPOSURE, _LENS]).swapaxes(1, 2)  # (3, TERMS, 2)
    return (N[:, _LENS, _LENS] - carried @ N[:, _EXPOSURE, _LENS]).sum(0), (r[:, _LENS] - (carried @ r[:, _EXPOSURE, None])[..., 0]).sum(0)


def exposure_changes(comparisons: Sequence[Comparison], lens: Vignette | None) -> bool:
    """Whether the exposure changes from image to image by more than the errors of comparisons between images of one exposure."""
    if not comparisons:
        return False
    normal = np.stack([c.normal[:, _EXPOSURE, _EXPOSURE] for c in comparisons]) + np.diag(prior()[_EXPOSURE])
    change = np.linalg.solve(normal, _without_lens(comparisons, lens)[..., None])[..., 0]  # (P, 3, 2)
    return float(((change[..., 0] + change[..., 1] / _MEDIUM) ** 2).mean()) ** 0.5 > _CHANGE


def _without_lens(comparisons: Sequence[Comparison], lens: Vignette | None) -> Floats:
    """The right sides (P, 3, 2) of the exposures' unknowns, with the vignetting taken out."""
    coefficients = np.array(Vignette().coefficients if lens is None else lens.coefficients)
    return np.stack([c.right[:, _EXPOSURE] - c.normal[:, _EXPOSURE, _LENS] @ coefficients for c in comparisons])


def exposure_over(comparisons: Sequence[Comparison], lens: Vignette | None) -> Floats:
    """The logarithm of the gain, and the offset, of each channel of one image over images of one exposure, (3, 2), with weak priors.

    comparisons: of the image with each of these.
    """
    normal = np.sum([c.normal[:, _EXPOSURE, _EXPOSURE] for c in comparisons], 0) + np.diag([_GAIN**-2, OFFSET**-2])
    return np.asarray(np.linalg.solve(normal, _without_lens(comparisons, lens).sum(0)[..., None])[..., 0])


def exposures(pairs: Sequence[tuple[int, int]], comparisons: Sequence[Comparison], count: int, lens: Vignette | None) -> Floats:
    """The logarithm of the gain, and the offset, of each channel of `count` images, (count, 3, 2). Those of image 0 are 0.

    comparisons: of the images a and b of each pair. An image that is compared with none has gain 1. Sparse least squares with weak priors.
    """
    out = np.zeros((count, 3, 2))
    if not pairs or count < 2:
        return out
    sides = _without_lens(comparisons, lens)
    a, b = np.array(pairs).T
    columns = np.stack([2 * a, 2 * a + 1, 2 * b, 2 * b + 1], 1)  # (P, 4)
    difference = np.array([[1.0, 0, -1, 0], [0, 1, 0, -1]])  # gain and offset of a less those of b
    rows, columns_of = np.repeat(columns, 4, 1).ravel(), np.tile(columns, (1, 4)).ravel()
    weak = np.tile([_GAIN**-2, OFFSET**-2], count)
    weak[:2] = 1e12  # the exposure of image 0 is given
    diagonal = np.arange(2 * count)
    for channel in range(3):
        normal = np.stack([c.normal[channel, _EXPOSURE, _EXPOSURE] for c in comparisons])
        blocks = difference.T @ normal @ difference
        values = np.concatenate([blocks.ravel(), weak])
        at = np.concatenate([rows, diagonal]), np.concatenate([columns_of, diagonal])
        side = np.bincount(columns.ravel(), (sides[:, channel] @ difference).ravel(), 2 * count)
        out[:, channel] = spsolve(coo_array((values, at), shape=(2 * count, 2 * count)).tocsc(), side).reshape(count, 2)
    return out
