"""Rectification of a frame taken in motion: as a global shutter would have seen it, with depth of the same moment.

Each row of a rolling shutter has a time of its own, and depth is seldom of the moment of colour. With the camera's velocity, each reading
is carried to the moment of colour's middle row: the motion compensation of lidar odometry, per pixel (Forssen and Ringaby, "Rectifying
rolling shutter video from hand-held devices", CVPR 2010, for rotations). All that follows then sees a synchronised global shutter.
"""

from dataclasses import dataclass, replace

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray
from torch import Tensor

from idfslam.frame import Frame
from idfslam.geometry.sensor_timing import SYNCHRONISED

Array = NDArray[np.float64]

# [px] Displacement within a frame below which nothing is rectified. More: slow frames keep a small distortion; less: they are resampled for
# nothing. A tenth of a pixel is about what photometric alignment resolves.
_NEGLIGIBLE = 0.1
# [1] Depth step, as a share of depth, across which readings are not averaged. More: edges are blurred. The sensor's noise is below 1 %.
_EDGE = 0.03
# [px] Largest distance from a pixel at which the reading found for it may land. More: fewer holes beside edges, and readings farther off.
_LANDING = 1.0
_LANDED = 0.05  # [px] distance at which the search ends. More: faster, and readings farther off
_STEPS = 3  # of the search for the raw pixel of a rectified one. More: nothing; each divides the error by more than ten
_SLOWEST = 1e-12  # [rad/s] below which a turn has no axis. More: nothing, up to what moves a pixel within a frame
_SPARSE = 8  # [px] stride of the readings whose median is the scene's distance. More: faster and noisier
_LEAST_DISTANCE = 0.1  # [m] of the scene, by which a shift is turned into pixels. More: shifts close to a surface count less


@dataclass(frozen=True)
class RowTimes:
    """When the rows of a frame are exposed [s], from the frame's time stamp on.

    Row r of H rows of colour at `readout` f with f = (r + 0.5) / H - 0.5, and of depth at `depth_delay + depth_readout` f.
    """

    readout: float = 0.0
    depth_readout: float = 0.0
    depth_delay: float = 0.0

    @property
    def array(self) -> Array:
        """(3,) [s] readout, depth readout and depth delay."""
        return np.array([self.readout, self.depth_readout, self.depth_delay])

    @property
    def synchronised(self) -> bool:
        """Whether all rows of both images are of one moment."""
        return self.readout == self.depth_readout == self.depth_delay == 0

    @property
    def longest(self) -> float:
        """[s] the largest difference of a row's time from the time stamp."""
        return max(self.readout / 2, abs(self.depth_delay) + self.depth_readout / 2)


@dataclass(frozen=True, eq=False)
class Rectification:
    """What a frame is rectified with."""

    times: RowTimes
    velocity: Array  # (6,) shift [m/s] and turn [rad/s] along the camera's axes, constant within the frame


def rectified(frame: Frame, rectification: Rectification) -> Frame:
    """The frame as a synchronised global shutter would have taken it at `frame.timestamp`: T_wc(t + s) = T_wc(t) exp(s velocity).

    Colour is rounded to steps of 1/255. A pixel to which no reading of depth can be carried has none. Returns the frame itself where it
    moves by less than a tenth of a pixel.
    """
    times, velocity, c = rectification.times, rectification.velocity, frame.camera
    if displacement(frame, velocity, times.longest) < _NEGLIGIBLE:
        return frame
    rows = (np.arange(c.height) + 0.5) / c.height - 0.5
    intrinsics = np.array([c.fx, c.fy, c.cx, c.cy], np.float32)
    depth = _rectified_depth(frame.depth, intrinsics, motions(velocity, times.depth_delay + times.depth_readout * rows))
    farthest = float(depth.max()) or 1.0
    colour = _rectified_colour(frame.colour, depth, farthest, intrinsics, motions(velocity, -times.readout * rows))
    return replace(frame, colour=colour, depth=depth, depth_timestamp=frame.timestamp, timing=SYNCHRONISED)


def displacement(frame: Frame, velocity: Array, duration: float) -> float:
    """About how far the image moves [px] in `duration` [s] at a velocity (6,), along whichever axes."""
    measured = frame.depth[::_SPARSE, ::_SPARSE]
    measured = measured[measured > 0]
    distance = max(float(np.median(measured)), _LEAST_DISTANCE) if len(measured) else 1.0
    return frame.camera.fx * duration * float(np.linalg.norm(velocity[3:]) + np.linalg.norm(velocity[:3]) / distance)


def along_camera(T_wc: Tensor, velocity: Array) -> Array:
    """A velocity (6,) along world axes, along the axes of a camera at `T_wc` (4, 4)."""
    R_wc = T_wc[:3, :3].numpy()
    return np.concatenate([R_wc.T @ velocity[:3], R_wc.T @ velocity[3:]])


def along_world(T_wc: Tensor, velocity: Array) -> Array:
    """A velocity (6,) along the axes of a camera at `T_wc` (4, 4), along world axes."""
    R_wc = T_wc[:3, :3].numpy()
    return np.concatenate([R_wc @ velocity[:3], R_wc @ velocity[3:]])


def turned(R: Array, covariance: Array) -> Array:
    """A covariance (6, 6) of a velocity, along other axes by a rotation (3, 3)."""
    both = np.kron(np.eye(2), R)
    return np.asarray(both @ covariance @ both.T)


def motions(velocity: Array, times: Array) -> NDArray[np.float32]:
    """(N, 3, 4) exp(s velocity) for each of the times s (N,) [s], the shift along the arc to second order."""
    x, y, z = velocity[3:] / max(float(np.linalg.norm(velocity[3:])), _SLOWEST)
    W = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = times * np.linalg.norm(velocity[3:])
    turn, half = (np.eye(3) + np.sin(a)[:, None, None] * W + (1 - np.cos(a))[:, None, None] * (W @ W) for a in (angle, angle / 2))
    return np.concatenate([turn, half @ (times[:, None] * velocity[:3])[..., None]], 2).astype(np.float32)


# Without fast mathematics: a parallel loop exists once by itself and once in its caller, each optimised in its own way, and which copy runs
# differs between the process that compiles it and later ones. A resumed run must see the same images, to the bit.
_parallel = njit(cache=True, nogil=True, error_model="numpy", parallel=True)
_inlined = njit(cache=True, nogil=True, error_model="numpy", forceinline=True)


@_parallel
def _rectified_depth(depth, intrinsics, motions):  # type: ignore[no-untyped-def]
    """(H, W) [m]: for each pixel the raw reading that lands on it, found by fixed-point iteration; 0 where none lands near it."""
    height, width = depth.shape
    fx, fy, cx, cy = intrinsics
    per_fx, per_fy = np.float32(1) / fx, np.float32(1) / fy
    out = np.zeros_like(depth)
    for row in prange(height):
        v = np.float32(row)  # numba widens sums of whole and 32-bit numbers to 64 bits
        shift_u, shift_v = np.float32(0), np.float32(0)  # from the pixel to its raw one; that of the neighbour is a good first guess
        for column in range(width):
            u, z = np.float32(column), np.float32(0)
            for _ in range(_STEPS):
                raw_u, raw_v = u + shift_u, v + shift_v
                d = _reading(depth, raw_u, raw_v)
                if d <= 0:
                    break
                M = motions[min(max(int(raw_v + np.float32(0.5)), 0), height - 1)]
                x, y = (raw_u - cx) * per_fx * d, (raw_v - cy) * per_fy * d
                z = M[2, 0] * x + M[2, 1] * y + M[2, 2] * d + M[2, 3]
                if z <= 0:
                    break
                per_z = np.float32(1) / z
                error_u = u - ((M[0, 0] * x + M[0, 1] * y + M[0, 2] * d + M[0, 3]) * per_z * fx + cx)
                error_v = v - ((M[1, 0] * x + M[1, 1] * y + M[1, 2] * d + M[1, 3]) * per_z * fy + cy)
                shift_u, shift_v = shift_u + error_u, shift_v + error_v
                if abs(error_u) + abs(error_v) < np.float32(_LANDED):
                    out[row, column] = z
                    break
                if abs(error_u) + abs(error_v) < np.float32(_LANDING):
                    out[row, column] = z
    return out


@_inlined
def _reading(depth, u, v):  # type: ignore[no-untyped-def]
    """The depth at a raw pixel: bilinear on one surface, else the nearest reading; 0 outside."""
    height, width = depth.shape
    half, zero, one = np.float32(0.5), np.float32(0), np.float32(1)
    if u < -half or v < -half or u > np.float32(width - 0.51) or v > np.float32(height - 0.51):
        return zero
    x, y = min(int(max(u, zero)), width - 2), min(int(max(v, zero)), height - 2)
    a, b = min(max(u - np.float32(x), zero), one), min(max(v - np.float32(y), zero), one)
    p, q, r, s = depth[y, x], depth[y, x + 1], depth[y + 1, x], depth[y + 1, x + 1]
    least, most = min(min(p, q), min(r, s)), max(max(p, q), max(r, s))
    if least > 0 and most - least < np.float32(_EDGE) * least:
        return (p * (one - a) + q * a) * (one - b) + (r * (one - a) + s * a) * b
    return depth[y + (1 if b >= half else 0), x + (1 if a >= half else 0)]


@_parallel
def _rectified_colour(colour, depth, farthest, intrinsics, motions):  # type: ignore[no-untyped-def]
    """(H, W, 3) in steps of 1/255: for each pixel the raw one at which its point was seen; without depth, a point at the last depth."""
    height, width = depth.shape
    fx, fy, cx, cy = intrinsics
    per_fx, per_fy, zero, one = np.float32(1) / fx, np.float32(1) / fy, np.float32(0), np.float32(1)
    out = np.empty_like(colour)
    for v in prange(height):
        z = np.float32(farthest)
        row = np.int64(v)  # a name of its own: the loop index of a parallel loop must not change
        for u in range(width):
            if depth[v, u] > 0:
                z = depth[v, u]
            x, y = (np.float32(u) - cx) * per_fx * z, (np.float32(v) - cy) * per_fy * z
            raw_u, raw_v = np.float32(u), np.float32(v)
            for _ in range(2):
                M = motions[row]
                per_depth = one / max(M[2, 0] * x + M[2, 1] * y + M[2, 2] * z + M[2, 3], np.float32(0.01))
                raw_u = (M[0, 0] * x + M[0, 1] * y + M[0, 2] * z + M[0, 3]) * per_depth * fx + cx
                raw_v = (M[1, 0] * x + M[1, 1] * y + M[1, 2] * z + M[1, 3]) * per_depth * fy + cy
                seen_in = min(max(int(raw_v + np.float32(0.5)), 0), height - 1)
                if seen_in == row:
                    break
                row = seen_in
            i, j = min(int(max(raw_u, zero)), width - 2), min(int(max(raw_v, zero)), height - 2)
            a, b = min(max(raw_u - np.float32(i), zero), one), min(max(raw_v - np.float32(j), zero), one)
            for k in range(3):
                upper = colour[j, i, k] * (one - a) + colour[j, i + 1, k] * a
                lower = colour[j + 1, i, k] * (one - a) + colour[j + 1, i + 1, k] * a
                out[v, u, k] = np.float32(int((upper * (one - b) + lower * b) * np.float32(255) + np.float32(0.5))) * np.float32(1 / 255)
    return out
