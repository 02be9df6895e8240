"""Time of a bundle adjustment against the number of keyframes: a walk that leaves places for good, or comes by again each lap.

    python benchmarks/adjustment_time.py [--keyframes 125 250 500 1000 2000] [--landmarks N] [--laps N]

Keyframes look out of a circle of 0.15 m a keyframe, and each sees the landmarks of its own and of about ten others before and behind. Noise
is half a pixel and 4 mm. It prints a table in Markdown: processor seconds of the whole adjustment and of one step, the time of a step over
that of n log n, entries of the factorised system, and the RMSE of the positions before and after.
"""

import argparse
from time import process_time

import numpy as np

from idfslam.compute.process import prepare_process

prepare_process()

import torch  # noqa: E402

from idfslam.adjustment.bundle_adjustment import Adjusted, Array, Problem, adjust, adjust_briefly, exp  # noqa: E402
from idfslam.adjustment.camera_model import NAMES, CameraModel  # noqa: E402
from idfslam.adjustment.observations import Indices, Observations, determined  # noqa: E402
from idfslam.adjustment.residuals import camera_points  # noqa: E402
from idfslam.geometry.camera import Camera  # noqa: E402
from idfslam.graph.measured_edges import measured_edge  # noqa: E402
from idfslam.graph.pose_graph import RelativePoses  # noqa: E402

CAMERA = Camera(320, 240, 288.0, 288.0, 159.5, 119.5)
STEP, DISTANCE = 0.15, 3.0  # [m] from keyframe to keyframe, and from the camera to the wall
IMAGE, DEPTH = 0.5, 0.004  # [px], [m] noise
DRIFT = 0.002, 0.001  # [m], [rad] error of a keyframe before the adjustment, relative to the one before


def walk(keyframes: int, laps: int) -> Array:
    """(K, 4, 4) true poses: T_wk, looking outwards from a circle."""
    radius = keyframes * STEP / laps / (2 * np.pi)
    turn = 2 * np.pi * laps * np.arange(keyframes) / keyframes
    poses = np.tile(np.eye(4), (keyframes, 1, 1))
    poses[:, :3, 2] = np.stack([np.cos(turn), np.sin(turn), 0 * turn], 1)
    poses[:, :3, 0] = np.stack([np.sin(turn), -np.cos(turn), 0 * turn], 1)
    poses[:, :3, 1] = [0, 0, -1]
    poses[:, :3, 3] = radius * poses[:, :3, 2]
    return poses


def problem(keyframes: int, landmarks: int, laps: int, rng: np.random.Generator) -> Problem:
    """Keyframes that have drifted, and `landmarks` that each of them hosts."""
    poses, model = walk(keyframes, laps), CameraModel.as_stated(CAMERA)
    host = np.repeat(np.arange(keyframes), landmarks)
    uv = rng.uniform([0, 0], [CAMERA.width - 1, CAMERA.height - 1], (len(host), 2))
    z = DISTANCE + rng.uniform(-0.5, 0.5, len(host))
    points = np.einsum("nij,nj->ni", poses[host, :3, :3], model.rays(uv) * z[:, None]) + poses[host, :3, 3]
    lap = keyframes // laps
    seen_from = [(host + away + lap * other) for away in range(-10, 11, 2) for other in range(-(laps - 1), laps)]
    keyframe, landmark = np.concatenate(seen_from), np.tile(np.arange(len(host)), len(seen_from))
    inside = (keyframe >= 0) & (keyframe < keyframes)
    order = np.lexsort((keyframe[inside], landmark[inside]))
    keyframe, landmark = keyframe[inside][order], landmark[inside][order]
    count = len(keyframe)
    flat, roots = np.zeros((count, 2)), np.tile(np.eye(2) / IMAGE, (count, 1, 1))
    blank = Observations(keyframe, landmark, flat, roots, np.ones(count), np.full(count, DEPTH), flat)
    p = camera_points(poses, points, blank)
    where = model.project(p)[0] + IMAGE * rng.standard_normal((count, 2))
    visible = (p[:, 2] > 0.5) & ((where >= 0) & (where < [CAMERA.width, CAMERA.height])).all(1)
    readings = p[:, 2] + DEPTH * rng.standard_normal(count)
    seen = Observations(keyframe, landmark, where, blank.root, readings, blank.reading_sigma, flat)[visible]
    steps = exp(np.concatenate([DRIFT[0] * rng.standard_normal((keyframes, 3)), DRIFT[1] * rng.standard_normal((keyframes, 3))], 1))
    off = [poses[0]]
    for i in range(1, keyframes):
        off.append(off[-1] @ np.linalg.inv(poses[i - 1]) @ poses[i] @ steps[i])
    start = np.array(off)
    found, seen = determined(start_points(poses, start, points, host), seen)
    relative = torch.from_numpy(np.linalg.inv(start[:-1]) @ start[1:])
    edges = RelativePoses.of([measured_edge(i, i + 1, T) for i, T in enumerate(relative)])
    return Problem(model, start, found, seen, np.arange(keyframes) == 0, np.zeros(len(NAMES), bool), edges)


def start_points(poses: Array, start: Array, points: Array, host: Indices) -> Array:
    """(L, 3) where hosts at the start see landmarks that lie at `points` for hosts at `poses`."""
    T = start[host] @ np.linalg.inv(poses[host])
    return np.asarray(np.einsum("nij,nj->ni", T[:, :3, :3], points) + T[:, :3, 3])


def rmse(poses: Array, truth: Array) -> float:
    """[cm] of the positions, relative to the first keyframe."""
    return float(100 * np.sqrt(((poses[:, :3, 3] - truth[:, :3, 3]) ** 2).sum(1).mean()))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--keyframes", type=int, nargs="+", default=[125, 250, 500, 1000, 2000])
    parser.add_argument("--landmarks", type=int, default=20)
    parser.add_argument("--laps", type=int, default=1)
    arguments = parser.parse_args()
    print(
        "| keyframes | sightings | s in all | s a step | over n log n | entries | before [cm] | after [cm] |\n|" + "---:|" * 8, flush=True
    )
    unit = 0.0
    for keyframes in arguments.keyframes:
        given = problem(keyframes, arguments.landmarks, arguments.laps, np.random.default_rng(0))
        begun = process_time()
        adjust_briefly(given, noise=np.ones(2), steps=1)
        step, begun = process_time() - begun, process_time()
        found: Adjusted = adjust(given)
        whole, size = process_time() - begun, keyframes * np.log(keyframes)
        unit = unit or step / size
        truth, poses = walk(keyframes, arguments.laps), (given.poses, found.problem.poses)
        print(
            f"| {keyframes} | {len(given.seen)} | {whole:.1f} | {step:.2f} | {step / size / unit:.2f} | {found.system.entries} | "
            f"{rmse(poses[0], truth):.1f} | {rmse(poses[1], truth):.2f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
