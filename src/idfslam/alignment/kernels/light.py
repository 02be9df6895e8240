"""Light that changes, everywhere alike and unevenly, compiled by Numba. The plain forms are `exposure`, `uneven_light.plain_relit` and
`flicker.plain_flicker`.
"""

import numpy as np
from numba import njit

from idfslam.alignment.constants import (
    BANDS,
    LARGEST_CHANGE,
    LARGEST_GAIN,
    LEAST_CHANGE,
    LEAST_DIFFERENCE,
    LEAST_EVIDENCE,
    LEAST_GAIN,
    LEAST_MEAN,
    LEAST_SPREAD,
    LIGHT_COLUMNS,
    LIGHT_ROWS,
    OUTLYING,
    SAME_EXPOSURE,
    UNCHANGED,
    UNLIT,
    UNMOVED,
)

_FASTMATH = {"contract", "reassoc", "nsz", "arcp"}
_inlined = njit(cache=True, nogil=True, fastmath=_FASTMATH, error_model="numpy", forceinline=True)  # why: numba_grid
_PARTS = LIGHT_ROWS * LIGHT_COLUMNS


@_inlined
def exposure_gain(mean_t: float, mean_v: float, variance_t: float, variance_v: float) -> float:
    """The gain by the brightness of landmarks in the keyframe and in the frame: `exposure.exposure`."""
    of_means = max(mean_v, LEAST_MEAN) / max(mean_t, LEAST_MEAN)
    change = min(max(min(max(1.0, of_means / SAME_EXPOSURE), of_means * SAME_EXPOSURE), LEAST_CHANGE), LARGEST_CHANGE)
    gain = np.sqrt(max(variance_v, 0.0)) / max(np.sqrt(max(variance_t, 0.0)), LEAST_SPREAD)
    return min(max(gain, LEAST_GAIN * change), LARGEST_GAIN * change)  # type: ignore[no-any-return]


@_inlined
def expected_brightness(target, value, light, expected) -> float:  # type: ignore[no-untyped-def]
    """Fills expected (n,) with gain * target + offset by value / light (each (n,)), and returns the gain: `exposure.exposure`."""
    n, sum_t, sum_v, sum_tt, sum_vv = len(target), 0.0, 0.0, 0.0, 0.0
    for k in range(n):
        even = value[k] / light[k]
        sum_t += target[k]
        sum_v += even
        sum_tt += target[k] * target[k]
        sum_vv += even * even
    mean_t, mean_v = sum_t / n, sum_v / n
    gain = exposure_gain(mean_t, mean_v, sum_tt / n - mean_t**2, sum_vv / n - mean_v**2)
    for k in range(n):
        expected[k] = mean_v + gain * (target[k] - mean_t)
    return gain  # type: ignore[no-any-return]


@_inlined
def relit(target, value, slopes, place, light, difference) -> float:  # type: ignore[no-untyped-def]
    """Fills light (n,) and difference (n,) of landmarks, and returns the gain of the image: `uneven_light.plain_relit`.

    target, value (n,), slopes (2, n), place (3, n): as there.
    """
    n = len(target)
    part, expected, weight = np.empty(n, np.int64), np.empty(n), np.ones(n)
    light[:] = 1.0
    expected_brightness(target, value, light, expected)
    steady, steady_slopes, flicker = value.copy(), slopes.copy(), np.ones(n)
    flickers = False
    for rows in (1, 2):  # of the frame, then of the keyframe
        if not _take_out_flicker(place[rows], expected, steady, steady_slopes, part, weight, flicker):
            break
        flickers = True
    for k in range(n):
        row, column = min(int(place[1, k] * LIGHT_ROWS), LIGHT_ROWS - 1), min(int(place[0, k] * LIGHT_COLUMNS), LIGHT_COLUMNS - 1)
        part[k] = row * LIGHT_COLUMNS + column
    weight[:] = 1.0
    if flickers:
        expected_brightness(target, steady, light, expected)
    change = np.empty((3, _PARTS))
    _solve_parts(part, expected, steady, steady_slopes, weight, UNCHANGED, change)
    _weigh(part, expected, steady, steady_slopes, change, weight)
    _light_at(change[0].reshape(LIGHT_ROWS, LIGHT_COLUMNS), place, light)
    gain = expected_brightness(target, steady, light, expected)
    _solve_parts(part, expected, steady, steady_slopes, weight, UNCHANGED, change)
    _light_at(change[0].reshape(LIGHT_ROWS, LIGHT_COLUMNS), place, light)
    for k in range(n):
        difference[k] = (steady[k] - expected[k] * light[k]) * flicker[k]
        light[k] *= flicker[k]
    return gain  # type: ignore[no-any-return]


@_inlined
def _take_out_flicker(rows, expected, value, slopes, band, weight, flicker) -> bool:  # type: ignore[no-untyped-def]
    """Divides value (n,) and slopes (2, n) by the light of bands of rows (n,), multiplies flicker (n,) by it, and returns whether any
    flickers: `flicker._of_bands`. band, weight (n,) are filled on the way.
    """
    n, share, change = len(rows), 0.0, np.empty((3, BANDS))
    for k in range(n):
        band[k] = min(int(rows[k] * BANDS), BANDS - 1)
        weight[k] = 1.0
    for _ in range(2):
        _solve_parts(band, expected, value, slopes, weight, UNLIT, change)
        shared, left, explained = 0.0, 0.0, 0.0
        for k in range(n):
            shared += change[0, band[k]] / n
        for k in range(n):
            of_light = expected[k] * change[0, band[k]]
            displaced = slopes[0, k] * change[1, band[k]] + slopes[1, k] * change[2, band[k]]
            left += abs(value[k] - expected[k] - of_light - displaced)
            explained += (expected[k] * (change[0, band[k]] - shared)) ** 2
        left /= n
        share = min(max(explained / max(LEAST_EVIDENCE * BANDS * left * left * np.pi / 2, 1e-12) - 1, 0.0), 1.0)
        if share == 0.0:
            return False
        _weigh(band, expected, value, slopes, change, weight)
    for k in range(n):
        at = min(max(rows[k] * BANDS - 0.5, 0.0), BANDS - 1.0)
        upper = min(int(at), BANDS - 2)
        a = at - upper
        light = 1 + share * (change[0, upper] * (1 - a) + change[0, upper + 1] * a)
        flicker[k] *= light
        value[k] /= light
        slopes[0, k] /= light
        slopes[1, k] /= light
    return True


@_inlined
def _solve_parts(part, expected, value, slopes, weight, unchanged, change) -> None:  # type: ignore[no-untyped-def]
    """Fills change (3, parts): of the light of each part of the image, and its displacement, which is eliminated.

    unchanged: as for `parts_of_light.changes`.
    """
    sums = np.zeros((change.shape[1], 10))
    for k in range(len(part)):
        s, w, p, u, v = sums[part[k]], weight[k], expected[k], slopes[0, k], slopes[1, k]
        r = value[k] - p
        s[0] += w * p * p
        s[1] += w * p * u
        s[2] += w * p * v
        s[3] += w * u * u
        s[4] += w * u * v
        s[5] += w * v * v
        s[6] += w * p * r
        s[7] += w * u * r
        s[8] += w * v * r
        s[9] += w
    for i in range(change.shape[1]):
        pp, pu, pv, uu, uv, vv, pr, ur, vr, count = sums[i]
        pp += unchanged * pp / max(count, 1e-9) + 1e-9
        ridge = UNMOVED * (uu + vv) / max(count, 1e-9) + 1e-9
        uu, vv = uu + ridge, vv + ridge
        determinant = uu * vv - uv * uv
        along_u, along_v = (vv * pu - uv * pv) / determinant, (uu * pv - uv * pu) / determinant
        alone = min(max(pr / pp, LEAST_CHANGE - 1), LARGEST_CHANGE - 1)
        of_light = (pr - along_u * ur - along_v * vr) / (pp - along_u * pu - along_v * pv)
        of_light = min(max(of_light, min(alone, 0.0)), max(alone, 0.0))
        ur, vr = ur - pu * of_light, vr - pv * of_light
        change[0, i], change[1, i], change[2, i] = of_light, (vv * ur - uv * vr) / determinant, (uu * vr - uv * ur) / determinant


@_inlined
def _weigh(part, expected, value, slopes, change, weight) -> None:  # type: ignore[no-untyped-def]
    """Fills weight (n,): robust, by what the change of its part does not explain of a landmark's brightness, over the mean of the part."""
    left, total, count = np.empty(len(part)), np.zeros(change.shape[1]), np.zeros(change.shape[1])
    for k in range(len(part)):
        i = part[k]
        left[k] = value[k] - expected[k] * (1 + change[0, i]) - slopes[0, k] * change[1, i] - slopes[1, k] * change[2, i]
        total[i] += abs(left[k])
        count[i] += 1
    for k in range(len(part)):
        outlying = left[k] / (OUTLYING * total[part[k]] / count[part[k]] + LEAST_DIFFERENCE)
        weight[k] = 1 / ((1 + outlying * outlying) * (1 + outlying * outlying))


@_inlined
def _light_at(change, place, light) -> None:  # type: ignore[no-untyped-def]
    """Fills light (n,) at places (2, n), bilinear between the centres of the parts (rows, columns)."""
    for k in range(len(light)):
        x = min(max(place[0, k] * LIGHT_COLUMNS - 0.5, 0.0), LIGHT_COLUMNS - 1.0)
        y = min(max(place[1, k] * LIGHT_ROWS - 0.5, 0.0), LIGHT_ROWS - 1.0)
        j, i = min(int(x), LIGHT_COLUMNS - 2), min(int(y), LIGHT_ROWS - 2)
        a, c = x - j, y - i
        upper, lower = change[i, j] * (1 - a) + change[i, j + 1] * a, change[i + 1, j] * (1 - a) + change[i + 1, j + 1] * a
        light[k] = 1 + upper * (1 - c) + lower * c
