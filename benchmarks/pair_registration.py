"""The tracker on pairs of views 10 to 20 degrees and 10 to 20 cm apart: how many it registers, and how exact they are.

    python benchmarks/pair_registration.py
    python benchmarks/pair_registration.py --photographs FOLDER --camera FX FY CX CY

Without photographs: generated rooms with a Kinect's noise, where the truth is exact, and hand-held recordings with all faults of a sensor,
a few frames apart. Photographs are compared neighbour with neighbour; the reference is SIFT and PnP on the full image.
`--without-patches` measures the tracker without the refinement.
"""

import argparse
from collections.abc import Iterator
from dataclasses import replace

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from idfslam.compute.process import prepare_process
from idfslam.config import FAST, FinetuneConfig
from idfslam.datasets import open_recording
from idfslam.datasets.generated.room import SyntheticRoom
from idfslam.datasets.generated.sensor_noise import noisy_colour, noisy_depth
from idfslam.errors import FrameError
from idfslam.frame import Frame, Status
from idfslam.geometry import se3
from idfslam.pretraining.validation import pose_error
from idfslam.tracking.tracker import Tracker, TrackingResult

Pair = tuple[Frame, Frame, NDArray[np.float64]]  # keyframe, frame, T_kc (4, 4)


def generated(seed: int, pairs: int) -> Iterator[Pair]:
    """Views of a room from a pose of its tour and from one 10 to 20 degrees and 10 to 20 cm away, in random directions."""
    room, rng = SyntheticRoom(seed, noise=True), np.random.default_rng([seed, 77])
    for _ in range(pairs):
        T_wk, axis, shift = room.ground_truth[rng.integers(len(room))], rng.normal(size=3) * [1, 1, 0.3], rng.normal(size=3)
        T_kc = np.eye(4)
        T_kc[:3, :3] = cv2.Rodrigues(axis / np.linalg.norm(axis) * np.deg2rad(rng.uniform(10, 20)))[0]
        T_kc[:3, 3] = shift / np.linalg.norm(shift) * rng.uniform(0.1, 0.2)
        frames = []
        for i, T_wc in enumerate((T_wk, T_wk @ T_kc)):
            seen, time = room.render(T_wc), rng.uniform(0, 9)
            depth = noisy_depth(seen.depth, seen.normals, room.camera, rng)
            frames.append(Frame(i, float(i), noisy_colour(seen.colour, time, rng), depth, room.camera))
        yield frames[0], frames[1], T_kc


def recorded(name: str, gap: int, pairs: int) -> Iterator[Pair]:
    """Frames of a recording with ground truth that are `gap` apart."""
    recording = open_recording(name)
    truth = np.asarray(recording.ground_truth)
    for i in np.linspace(0, len(recording) - 1 - gap, pairs).astype(int).tolist():
        try:
            yield recording[i], recording[i + gap], np.linalg.inv(truth[i]) @ truth[i + gap]
        except FrameError:
            continue


def photographs(folder: str, camera: list[float]) -> Iterator[Pair]:
    """Neighbouring photographs, with T_kc by SIFT and PnP."""
    recording = open_recording(folder, camera=dict(zip(("fx", "fy", "cx", "cy"), camera)))
    for i in range(len(recording) - 1):
        yield recording[i], recording[i + 1], sift_and_pnp(recording[i], recording[i + 1])


def sift_and_pnp(keyframe: Frame, frame: Frame) -> NDArray[np.float64]:
    """T_kc (4, 4) by SIFT, the ratio test and PnP with the keyframe's depth."""
    sift, camera = cv2.SIFT_create(4000), keyframe.camera  # type: ignore[attr-defined]
    (at_k, d_k), (at_c, d_c) = (
        sift.detectAndCompute(cv2.cvtColor((f.colour * 255).round().astype(np.uint8), cv2.COLOR_RGB2GRAY), None) for f in (keyframe, frame)
    )
    good = [m for m, second in cv2.BFMatcher().knnMatch(d_k, d_c, 2) if m.distance < 0.75 * second.distance]
    uv_k, uv = np.array([at_k[m.queryIdx].pt for m in good]), np.array([at_c[m.trainIdx].pt for m in good])
    z = keyframe.depth[tuple(uv_k.round().astype(int).T[::-1])].astype(np.float64)
    points, K = camera.rays(torch.from_numpy(uv_k)).numpy() * z[:, None], camera.matrix().numpy()
    points, uv = points[z > 0], uv[z > 0]
    _, turn, shift, inliers = cv2.solvePnPRansac(points, uv, K, None, reprojectionError=2.0, iterationsCount=2000, confidence=0.9999)
    turn, shift = cv2.solvePnPRefineLM(points[inliers[:, 0]], uv[inliers[:, 0]], K, None, turn, shift)
    T_ck = np.eye(4)
    T_ck[:3, :3], T_ck[:3, 3] = cv2.Rodrigues(turn)[0], shift[:, 0]
    return np.asarray(np.linalg.inv(T_ck), np.float64)


def nees(result: TrackingResult, T_kc: NDArray[np.float64]) -> float:
    """Normalised squared error of the pose by its covariance; 1 if the covariance is honest, nan without one."""
    if result.covariance is None:
        return float("nan")
    delta = se3.log(torch.from_numpy(T_kc) @ se3.inverse(torch.from_numpy(result.T_kc))).numpy()
    return float(delta @ np.linalg.solve(result.covariance, delta)) / 6


def measure(name: str, pairs: Iterator[Pair], tracker: Tracker) -> None:
    """Prints a row of the table."""
    rows = []
    for keyframe, frame, T_kc in pairs:
        result = tracker.track(tracker.extract_features(frame), tracker.extract_features(keyframe))
        rows.append((result.status is not Status.LOST, *pose_error(result.T_kc, T_kc), nees(result, T_kc)))
    registered, rotation, translation, honesty = np.array(rows, float).T
    near = (rotation < 1) & (translation < 2)
    half, most = ((np.quantile(rotation, q), np.quantile(translation, q)) for q in (0.5, 0.9))
    cells = f"{half[0]:.2f}, {most[0]:.2f} | {half[1]:.2f}, {most[1]:.2f} | {np.median(honesty):.2f}"
    print(f"| {name} | {len(rows)} | {registered.sum():.0f} | {near.sum()} | {cells} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--photographs")
    parser.add_argument("--camera", type=float, nargs=4, metavar=("FX", "FY", "CX", "CY"))
    parser.add_argument("--recordings", nargs="*", default=["synthetic:2:handheld", "synthetic:3:handheld"])
    parser.add_argument("--pairs", type=int, default=10)
    parser.add_argument("--without-patches", action="store_true")
    arguments = parser.parse_args()
    prepare_process()
    torch.set_num_threads(1)
    tracker = Tracker(replace(FAST.tracker, patches=not arguments.without_patches), FinetuneConfig(enabled=False))
    print("| pairs | n | registered | < 1° and < 2 cm | rotation, median, 90 % [°] | translation [cm] | NEES, median |")
    print("|---|--:|--:|--:|--:|--:|--:|")
    if arguments.photographs:
        measure("photographs", photographs(arguments.photographs, arguments.camera), tracker)
        return
    for seed in range(5):
        measure(f"generated room {seed}", generated(seed, arguments.pairs), tracker)
    for name in arguments.recordings:
        for gap in (4, 8):
            measure(f"{name}, {gap} frames apart", recorded(name, gap, arguments.pairs), tracker)


if __name__ == "__main__":
    main()
