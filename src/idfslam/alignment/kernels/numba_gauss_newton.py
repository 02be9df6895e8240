"""Gauss-Newton steps of a pose on the CPU, compiled by Numba. The plain forms are in `gauss_newton`."""

import numpy as np
from numba import njit

from idfslam.alignment.constants import LEAST_RADIUS, LEAST_VALUE
from idfslam.alignment.kernels.numba_motion import move
from idfslam.geometry.cholesky import solved

_FASTMATH = {"contract", "reassoc", "nsz", "arcp"}
_compiled = njit(cache=True, nogil=True, fastmath=_FASTMATH, error_model="numpy")


@_compiled
def joint_step(depth_H, depth_b, image_H, image_b, times, information, scale, from_prior, delta) -> None:  # type: ignore[no-untyped-def]
    """Fills delta (18,), the change of pose, velocity and the references' error of velocity: `gauss_newton.joint_step`.

    Velocity and references' error act alike on the residuals, so that their rows and columns are the same.
    """
    readout, depth_readout, delay = times
    left, right = information.copy(), np.empty(18)
    for i in range(18):
        k = i % 6
        by_velocity = i >= 6
        if by_velocity:
            right[i] = scale * (delay * depth_b[0, k] + depth_readout * depth_b[1, k] + readout * image_b[1, k])
        else:
            right[i] = scale * (depth_b[0, k] + image_b[0, k])
        for j in range(18):
            m = j % 6
            if by_velocity and j >= 6:
                h = delay * (delay * depth_H[0, k, m] + 2 * depth_readout * depth_H[1, k, m])
                h += depth_readout * depth_readout * depth_H[2, k, m] + readout * readout * image_H[2, k, m]
            elif by_velocity or j >= 6:
                h = delay * depth_H[0, k, m] + depth_readout * depth_H[1, k, m] + readout * image_H[1, k, m]
            else:
                h = depth_H[0, k, m] + image_H[0, k, m]
            left[i, j] += scale * h
            right[i] -= information[i, j] * from_prior[j]
            if j >= 12:
                right[i] -= scale * h * from_prior[j]
    delta[:] = solved(left, right)


@_compiled
def damped_step(H, b, weight, radius, prior_information, change, T) -> float:  # type: ignore[no-untyped-def]
    """A Gauss-Newton step of normal equations H (6, 6), b (6,) with a prior at the guess: `gauss_newton.plain_damped_step`.

    Moves in place the pose T (4, 4) and its change since the guess, change (6,). Returns the largest entry of the step.
    """
    unit = np.ones(6)
    unit[3:] = 1 / max(radius, LEAST_RADIUS)
    scaled = np.empty((6, 6))
    for i in range(6):
        for j in range(6):
            scaled[i, j] = H[i, j] * unit[i] * unit[j] / max(weight, 1e-9)
    values, directions = np.linalg.eigh(scaled)
    held = np.empty(6)
    for i in range(6):
        held[i] = max(weight, 1e-9) * prior_information**4 / max(values[i], LEAST_VALUE * prior_information) ** 3
    left, right = np.empty((6, 6)), b.copy()
    for i in range(6):
        for j in range(6):
            prior = 0.0
            for k in range(6):
                prior += directions[i, k] * held[k] * directions[j, k]
            prior /= unit[i] * unit[j]
            left[i, j] = H[i, j] + prior
            right[i] -= prior * change[j]
    delta = solved(left, right)
    change += delta
    move(T, delta, T)
    return np.abs(delta).max()
