"""The same places in two images: what their colours say about the exposures of both and about the vignetting.

The logarithm of a colour in image a minus that in image b is

    log gain_a - log gain_b + (offset_a - offset_b) / colour + sum_k c_k (r_a^2k - r_b^2k),

to first order in the offsets, which are in the scene's units. It is linear in all unknowns. The two images stand for each other (the colour
is the mean of both), so noise does not draw the gain to one side as it does in a regression of the one on the other.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from idfslam.geometry.cholesky import solved
from idfslam.sensing.vignette import TERMS

Floats = NDArray[np.float64]

UNKNOWNS = 2 + TERMS  # log gain of a over b, offset of a less that of b, coefficients of the vignette: a fact, not a choice
DARKEST, BRIGHTEST = 0.06, 0.94  # [1] colours that count: black and white are clipped. Wider: more places, and clipped ones. By hand
OFFSET = 0.005  # [1] standard deviation of an offset before anything is seen; more: noise of contrast counts as an offset. Chosen by hand
_VIGNETTE = 1.0  # [1] standard deviation of a coefficient of the vignette before anything is seen; more: none, noise counts. By hand
_SCATTER = 2.0  # [1] width of the robust kernel, in standard deviations of the differences; more: reflections and errors count. By hand
_DEVIATION = 1.4826  # [1] standard deviation of a normal distribution over its median absolute deviation: a fact, not a choice
_ROUNDS = 3  # of reweighting; more: slower, and outliers leave more surely. Chosen by hand
_LEAST_SCATTER = 0.01  # [1] of the logarithms; more: exact images count no more than others. Chosen by hand
_INDEPENDENT = 400  # places that count as independent, since neighbours err together; more: the prior counts less. Chosen by hand
LEAST_PLACES = 150  # [1] in each channel; more: fewer pairs of images are compared. Chosen by hand


@dataclass(frozen=True)
class Comparison:
    """Normal equations of a pair of images for each channel. Unknowns: see `UNKNOWNS`."""

    normal: Floats  # (3, UNKNOWNS, UNKNOWNS)
    right: Floats  # (3, UNKNOWNS)


def compare(a: Floats, b: Floats, powers_a: Floats, powers_b: Floats, noise: Floats) -> Comparison | None:
    """Compares the colours a, b (N, 3) of N places in two images; None if too few are neither black nor white.

    powers_a, powers_b (N, TERMS): the even powers of their radii. noise (N,): standard deviation of the difference of the colours.
    """
    places = [np.ascontiguousarray(column, np.float64) for column in (a, b, powers_a, powers_b, noise)]
    normal, right = np.empty((3, UNKNOWNS, UNKNOWNS)), np.empty((3, UNKNOWNS))
    J, difference, sigma = np.empty((len(a), UNKNOWNS)), np.empty(len(a)), np.empty(len(a))
    for channel in range(3):
        usable = _fill_differences(*places, channel, J, difference, sigma)  # type: ignore[call-arg]
        if usable < LEAST_PLACES:
            return None
        normal[channel], right[channel] = _robust(J[:usable], difference[:usable], sigma[:usable])
    return Comparison(normal, right)


@njit(cache=True, nogil=True, error_model="numpy")
def _fill_differences(a, b, powers_a, powers_b, noise, channel, J, difference, sigma) -> int:  # type: ignore[no-untyped-def]
    """Fills Jacobians J (N, K), differences (N,) and sigma (N,) of the places whose colour in a channel counts; returns their number."""
    usable = 0
    for n in range(len(a)):
        of_a, of_b = a[n, channel], b[n, channel]
        if not (min(of_a, of_b) > DARKEST and max(of_a, of_b) < BRIGHTEST):
            continue
        colour = (of_a + of_b) / 2
        J[usable, 0], J[usable, 1] = 1.0, 1 / colour
        for k in range(powers_a.shape[1]):
            J[usable, 2 + k] = powers_a[n, k] - powers_b[n, k]
        difference[usable], sigma[usable] = np.log(of_a / of_b), noise[n] / colour
        usable += 1
    return usable


def _robust(J: Floats, difference: Floats, sigma: Floats) -> tuple[Floats, Floats]:
    """Normal equations of J x = difference, with robust weights, for differences whose noise is in proportion to sigma (N,)."""
    normal, right = np.empty((J.shape[1], J.shape[1])), np.empty(J.shape[1])
    _fill_robust(J, difference, sigma, np.diag(prior()), normal, right)
    share = min(1.0, _INDEPENDENT / len(difference))
    return share * normal, share * right


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "nsz", "arcp"}, error_model="numpy")
def _fill_robust(J, difference, sigma, of_prior, normal, right) -> None:  # type: ignore[no-untyped-def]
    """Fills the sums of all places, normal (K, K) and right (K,), for `_robust`. of_prior (K, K): information on x."""
    n, unknowns = J.shape
    r = (difference - np.median(difference)) / sigma
    least = _LEAST_SCATTER / np.median(sigma)
    for _ in range(_ROUNDS):
        scale = max(_DEVIATION * np.median(np.abs(r)), least)
        normal[:] = 0.0
        right[:] = 0.0
        for i in range(n):
            q, s = r[i] / (_SCATTER * scale), scale * sigma[i]
            kernel = 1 + q * q
            weight = 1 / (kernel * kernel * s * s)
            for a in range(unknowns):
                scaled = weight * J[i, a]
                right[a] += scaled * difference[i]
                for b in range(a + 1):
                    normal[a, b] += scaled * J[i, b]
        for a in range(unknowns):
            for b in range(a):
                normal[b, a] = normal[a, b]
        x = solved(normal + of_prior, right.copy())
        for i in range(n):
            explained = 0.0
            for a in range(unknowns):
                explained += J[i, a] * x[a]
            r[i] = (difference[i] - explained) / sigma[i]


def prior() -> Floats:
    """The diagonal (UNKNOWNS,) of the information about the unknowns before anything is seen."""
    return np.array([1e-6, OFFSET**-2, *[_VIGNETTE**-2] * TERMS])
