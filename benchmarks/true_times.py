"""The read-out times and delays of a recording's sensor that fit its true poses best, without SLAM.

    python benchmarks/true_times.py FOLDER [--frames N]

FOLDER is a recording in TUM's layout whose groundtruth.txt has poses more often than images, as motion capture has. Colour: features of
frames 4 and 8 apart, of which the first have depth, are projected by the true poses at the times of their rows. Depth: the points of frames
3 and 6 apart lie on one another's surfaces (point to plane). Robust least squares find the read-out time and the delay of both.
"""

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation, Slerp

from idfslam.datasets import open_recording
from idfslam.frame import Frame

Array = NDArray[np.float64]
FARTHEST = 3.0  # [m]
FEATURES, RATIO = 3000, 0.7  # of an image; largest ratio of the distances of the best and the second match (Lowe 2004)
POINTS, ASSOCIATIONS, NEAR = 400, 6, 0.12  # of a depth image; rounds; [m] to the plane
NOISE = 0.002, 0.003  # [m], [1/m] of depth: constant, and times z^2


class TruePath:
    """The true pose at any time."""

    def __init__(self, file: Path) -> None:
        rows = np.loadtxt(file)
        self.start = rows[0, 0]  # [s] stamps count from here: those of a clock have no nanoseconds left
        rows[:, 0] -= self.start
        self.stamps, self.positions, self.turns = rows[:, 0], rows[:, 1:4], Slerp(rows[:, 0], Rotation.from_quat(rows[:, 4:8]))

    def at(self, stamps: Array) -> tuple[Rotation, Array]:
        """Rotations and positions (N, 3) at N stamps [s]."""
        stamps = np.clip(stamps, self.stamps[0], self.stamps[-1])
        return self.turns(stamps), np.stack([np.interp(stamps, self.stamps, column) for column in self.positions.T], 1)


def carried(path: TruePath, points: Array, of: Array, to: Array) -> Array:
    """Points (N, 3) in the camera at the stamps `of` (N,), in the camera at the stamps `to` (N,)."""
    (R, t), (Q, s) = path.at(of), path.at(to)
    return np.asarray(Q.inv().apply(R.apply(points) + t - s))


def matches(frames: list[Frame]) -> Array:
    """(M, 7) stamp and pixel of a feature, its depth, stamp and pixel of its match."""
    sift, found, rows = cv2.SIFT.create(FEATURES), [], []
    for frame in frames:
        found.append(sift.detectAndCompute(cv2.cvtColor((255 * frame.colour).astype(np.uint8), cv2.COLOR_RGB2GRAY), None))
    for i in range(0, len(frames), 3):
        for j in (i + 4, i + 8):
            if j >= len(frames) or found[i][1] is None or found[j][1] is None:
                continue
            a, b = frames[i], frames[j]
            for pair in cv2.BFMatcher().knnMatch(found[i][1], found[j][1], k=2):
                if len(pair) < 2 or pair[0].distance > RATIO * pair[1].distance:
                    continue
                u, v = found[i][0][pair[0].queryIdx].pt
                around = a.depth[max(int(v) - 2, 0) : int(v) + 3, max(int(u) - 2, 0) : int(u) + 3]
                if (around > 0).all() and np.ptp(around) < 0.03 and around.mean() < FARTHEST:
                    rows.append([a.timestamp, u, v, float(around.mean()), b.timestamp, *found[j][0][pair[0].trainIdx].pt])
    return np.array(rows)


def of_colour(frames: list[Frame], path: TruePath) -> tuple[Array, Array]:
    """Read-out time and delay [s] of colour against the true poses, and their standard deviations."""
    M, camera = matches(frames), frames[0].camera
    points = np.stack([(M[:, 1] - camera.cx) / camera.fx, (M[:, 2] - camera.cy) / camera.fy, np.ones(len(M))], 1) * M[:, 3:4]

    def off(times: Array) -> Array:
        of, to = (M[:, k] + times[1] + times[0] * (M[:, k + 2] / camera.height - 0.5) for k in (0, 4))
        x, y, z = carried(path, points, of, to).T
        return np.concatenate([camera.fx * x / z + camera.cx - M[:, 5], camera.fy * y / z + camera.cy - M[:, 6]])

    return fitted(off, np.zeros(2), scale=1.5)


def surface(frame: Frame) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Points and normals (H, W, 3) of a depth image, and where it is smooth (H, W)."""
    camera, depth = frame.camera, frame.depth.astype(np.float64)
    v, u = np.mgrid[: camera.height, : camera.width]
    points = np.stack([(u - camera.cx) * depth / camera.fx, (v - camera.cy) * depth / camera.fy, depth], -1)
    mean = cv2.blur(points, (7, 7))
    normals = np.cross(np.roll(mean, -4, 1) - np.roll(mean, 4, 1), np.roll(mean, -4, 0) - np.roll(mean, 4, 0))
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True) + 1e-12
    least, most = cv2.erode(depth, np.ones((9, 9))), cv2.dilate(depth, np.ones((9, 9)))
    return points, normals, (least > 0) & (most - least < 0.06 * depth) & (depth < FARTHEST)


def of_depth(frames: list[Frame], path: TruePath) -> tuple[Array, Array]:
    """The same of depth, whose delay is against its own stamps."""
    camera, rng, times = frames[0].camera, np.random.default_rng(0), np.zeros(2)
    stamps, height = [frame.timestamp + frame.depth_lag for frame in frames], camera.height
    surfaces = [surface(frame) for frame in frames]
    sigma = np.zeros(2)
    for _ in range(ASSOCIATIONS):
        rows = []
        for i, j in ((i, i + gap) for i in range(0, len(frames), 3) for gap in (3, 6) if i + gap < len(frames)):
            (points, _, smooth), (others, normals, fit) = surfaces[i], surfaces[j]
            if not smooth.any():
                continue
            place = rng.permutation(np.argwhere(smooth))[:POINTS]
            X, row = points[tuple(place.T)], place[:, 0].astype(np.float64)
            for _ in range(2):
                of = stamps[i] + times[1] + times[0] * (place[:, 0] / height - 0.5)
                Y = carried(path, X, of, stamps[j] + times[1] + times[0] * (row / height - 0.5))
                row = np.clip(camera.fy * Y[:, 1] / np.maximum(Y[:, 2], 0.1) + camera.cy, 0, height - 1)
            u = np.rint(camera.fx * Y[:, 0] / np.maximum(Y[:, 2], 0.1) + camera.cx).astype(int)
            v, inside = np.rint(row).astype(int), (Y[:, 2] > 0.1) & (u >= 0) & (u < camera.width)
            inside[inside] &= fit[v[inside], u[inside]]
            X, Y, place, u, v = (part[inside] for part in (X, Y, place, u, v))
            Q, n = others[v, u], normals[v, u]
            near = np.abs(((Y - Q) * n).sum(1)) < NEAR
            both = np.tile([stamps[i], stamps[j]], (int(near.sum()), 1))
            rows.append(np.concatenate([both, X[near], Q[near], n[near], place[near, :1], v[near, None]], 1))
        M = np.concatenate(rows)

        def off(times: Array, M: Array = M) -> Array:
            of, to = (M[:, k] + times[1] + times[0] * (M[:, 11 + k] / height - 0.5) for k in (0, 1))
            distance = ((carried(path, M[:, 2:5], of, to) - M[:, 5:8]) * M[:, 8:11]).sum(1)
            return np.asarray(distance / (NOISE[0] + NOISE[1] * M[:, 7] ** 2))

        times, sigma = fitted(off, times, scale=1.0)
    return times, sigma


def fitted(off: Callable[[Array], Array], start: Array, scale: float) -> tuple[Array, Array]:
    """The least squares of residuals, robust beyond `scale`, and the standard deviations."""
    found = least_squares(lambda ms: off(ms / 1000), 1000 * start, jac="3-point", loss="cauchy", f_scale=scale)
    return found.x / 1000, np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac))) / 1000


def since(frame: Frame, start: float) -> Frame:
    """A frame whose stamps count from `start` [s]."""
    depth = None if frame.depth_timestamp is None else frame.depth_timestamp - start
    return replace(frame, timestamp=frame.timestamp - start, depth_timestamp=depth)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--frames", type=int)
    arguments = parser.parse_args()
    recording, path = open_recording(str(arguments.folder), frames=arguments.frames), TruePath(arguments.folder / "groundtruth.txt")
    frames = [since(recording[i], path.start) for i in range(len(recording))]
    (colour, of_c), (depth, of_d) = of_colour(frames, path), of_depth(frames, path)
    print("| | read-out [ms] | delay against the true poses [ms] |\n|---|---:|---:|")
    for name, times, sigmas in (("colour", colour, of_c), ("depth", depth, of_d)):
        print(f"| {name} | {1000 * times[0]:.1f} ± {1000 * sigmas[0]:.1f} | {1000 * times[1]:.1f} ± {1000 * sigmas[1]:.1f} |")
    print(f"\ndepth is {1000 * (depth[1] - colour[1]):.1f} ms later than its stamps say, against colour")


if __name__ == "__main__":
    main()
