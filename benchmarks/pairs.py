"""Tracking of frame pairs some frames apart: rotation and translation errors by gap, features against features.

    python benchmarks/pairs.py RECORDING [--gaps 5 10 20] [--pairs 50] [--preset fast] [--weights FILE ...] [--sift]

RECORDING needs ground-truth poses; they are read by this script only. Each row is one set of features with the same estimator: the
weights shipped with the package, each --weights FILE, and, with --sift, OpenCV's SIFT matched mutually on the full image.
"""

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from idfslam.config import FinetuneConfig, TrackerConfig, preset
from idfslam.datasets import open_recording
from idfslam.frame import Frame, Status
from idfslam.tracking.registration import register
from idfslam.tracking.tracker import Tracker

Estimate = Callable[[Frame, Frame], tuple[NDArray[np.float64], bool]]


def learned(config: TrackerConfig) -> Estimate:
    """The tracker on fresh descriptions of both frames."""
    tracker = Tracker(config, FinetuneConfig(enabled=False))

    def estimate(frame: Frame, keyframe: Frame) -> tuple[NDArray[np.float64], bool]:
        result = tracker.track(tracker.describe(frame), tracker.describe(keyframe))
        return result.T_kc, result.status is Status.OK

    return estimate


def sift(config: TrackerConfig) -> Estimate:
    """SIFT keypoints with depth, mutual nearest neighbours, the ratio as weight, the same robust Procrustes."""
    detector, generator = cv2.SIFT_create(1000), torch.Generator().manual_seed(0)

    def keypoints(frame: Frame) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        grey = cv2.cvtColor((frame.colour * 255).astype(np.uint8), cv2.COLOR_RGB2GRAY)
        found, descriptors = detector.detectAndCompute(grey, None)
        uv = np.array([point.pt for point in found]).reshape(-1, 2)
        depth = frame.depth[tuple(uv.round().astype(int).T[::-1])] if len(uv) else np.zeros(0, np.float32)
        points = frame.camera.rays(torch.from_numpy(uv)).numpy() * depth[:, None]
        return points[depth > 0], descriptors[depth > 0] if len(uv) else np.zeros((0, 128), np.float32)

    def estimate(frame: Frame, keyframe: Frame) -> tuple[NDArray[np.float64], bool]:
        (points_c, desc_c), (points_k, desc_k) = keypoints(frame), keypoints(keyframe)
        if min(len(desc_c), len(desc_k)) < 3:
            return np.eye(4), False
        matcher = cv2.BFMatcher()
        back = {m[0].queryIdx: m[0].trainIdx for m in matcher.knnMatch(desc_k, desc_c, 1)}
        pairs = [(a, b) for a, b in matcher.knnMatch(desc_c, desc_k, 2) if back[a.trainIdx] == a.queryIdx]
        pairs = sorted(pairs, key=lambda pair: pair[0].distance / pair[1].distance)[: config.matches]
        if len(pairs) < max(3, config.min_inliers):
            return np.eye(4), False
        weight = torch.tensor([1 - a.distance / b.distance for a, b in pairs])
        source = torch.from_numpy(points_c[[a.queryIdx for a, _ in pairs]])
        target = torch.from_numpy(points_k[[a.trainIdx for a, _ in pairs]])
        options = {"subsets": config.subsets, "share": config.subset_share, "truncation": config.truncation, "refits": config.refits}
        found = register(source, target, weight, inlier_distance=config.inlier_distance, generator=generator, **options)
        enough = int(found.inliers.sum()) >= max(config.min_inliers, config.min_inlier_share * len(pairs))
        return found.T_ab.numpy(), enough

    return estimate


def errors(T: NDArray[np.float64], truth: NDArray[np.float64]) -> tuple[float, float]:
    """Rotation [degrees] and translation [cm] between two transforms."""
    delta = np.linalg.inv(truth) @ T
    angle = np.degrees(np.arccos(np.clip((np.trace(delta[:3, :3]) - 1) / 2, -1, 1)))
    return float(angle), float(np.linalg.norm(delta[:3, 3]) * 100)


def report(name: str, estimate: Estimate, recording: object, gap: int, pairs: int) -> str:
    """One row: median and 90th percentile of both errors over all pairs, share called OK, worst error among those."""
    starts = np.linspace(0, len(recording) - 1 - gap, pairs).astype(int)
    rows, accepted, began = [], [], time.perf_counter()
    for i in starts:
        T, ok = estimate(recording[i + gap], recording[i])
        truth = np.linalg.inv(recording.ground_truth[i]) @ recording.ground_truth[i + gap]
        rows.append(errors(T, truth))
        accepted.append(ok)
    seconds = time.perf_counter() - began
    error, ok = np.array(rows), np.array(accepted)
    (r50, t50), (r90, t90) = np.median(error, 0), np.percentile(error, 90, axis=0)
    good = (error[:, 0] < 5) & (error[:, 1] < 15)
    return (
        f"| {name} | {gap} | {r50:.2f} | {r90:.2f} | {t50:.1f} | {t90:.1f} | {good.mean():.0%} | {ok.mean():.0%} "
        f"| {(ok & ~good).sum()} | {seconds / pairs * 1e3:.0f} |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording", type=Path)
    parser.add_argument("--gaps", type=int, nargs="+", default=[5, 10, 20])
    parser.add_argument("--pairs", type=int, default=50)
    parser.add_argument("--preset", default="fast")
    parser.add_argument("--weights", type=Path, nargs="*", default=[])
    parser.add_argument("--sift", action="store_true")
    arguments = parser.parse_args()
    config = preset(arguments.preset).tracker
    rows = {"shipped": learned(config)} | {path.stem: learned(replace(config, weights=path)) for path in arguments.weights}
    rows |= {"SIFT": sift(config)} if arguments.sift else {}
    recording = open_recording(arguments.recording)
    columns = "features, gap, rot. median [deg], 90 %, transl. median [cm], 90 %, 5 deg and 15 cm, called OK, of these wrong, ms a pair"
    print("| " + columns.replace(", ", " | ") + " |\n" + "|---" * 10 + "|")
    for gap in arguments.gaps:
        for name, estimate in rows.items():
            print(report(name, estimate, recording, gap, arguments.pairs), flush=True)


if __name__ == "__main__":
    main()
