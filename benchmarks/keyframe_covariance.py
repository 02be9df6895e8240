"""Are the covariances of keyframe poses honest? The error of each adjusted keyframe against its covariance, over seeds.

    python benchmarks/keyframe_covariance.py [SCENE ...] [--seeds N] [--frames N] [--size WxH]

SCENE is `synthetic` or `corridor`, followed by `:kinect` or nothing; seed S runs scene S. It prints a table in Markdown: the normalised
squared error (NEES) over all keyframes, whose mean is 1 if covariances are honest, its median, and the error of the keyframes' positions
before and after the adjustment. Poses are relative to the first keyframe, which has no error.
"""

import argparse
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from idfslam.compute.process import prepare_process

prepare_process()

import torch  # noqa: E402

from idfslam.config import FAST  # noqa: E402
from idfslam.datasets.generated.corridor import SyntheticCorridor  # noqa: E402
from idfslam.datasets.generated.room import SyntheticRoom  # noqa: E402
from idfslam.datasets.recording import Dataset, Selection  # noqa: E402
from idfslam.evaluation.trajectory_error import absolute_trajectory_error  # noqa: E402
from idfslam.frame import StoredKeyframe  # noqa: E402
from idfslam.geometry import se3  # noqa: E402
from idfslam.runs.source import read_frames  # noqa: E402
from idfslam.slam import Slam  # noqa: E402

Array = NDArray[np.float64]


def opened(scene: str, seed: int, frames: int, size: tuple[int, int]) -> Dataset:
    """Scene `seed`: a room, or a corridor, with the noise of a Kinect or without noise."""
    kind, _, noise = scene.partition(":")
    if kind not in ("synthetic", "corridor") or noise not in ("", "kinect"):
        raise SystemExit(f"{scene}: no such scene; expected synthetic or corridor, and :kinect or nothing")
    make = SyntheticRoom if kind == "synthetic" else SyntheticCorridor
    return Selection(make(seed=seed, width=size[0], height=size[1], noise=noise == "kinect"), frames=frames)


def positions_off(keyframes: list[StoredKeyframe], truth: Array) -> float:
    """[cm] RMSE of the keyframes' positions after alignment."""
    chosen = [k.index for k in keyframes]
    return 100 * absolute_trajectory_error(np.array([k.T_wk for k in keyframes]), truth[chosen]).translation.rmse


def squared_errors(keyframes: list[StoredKeyframe], truth: Array) -> list[float]:
    """The squared error of each pose in units of its covariance, a sixth of it. The first keyframe is the world, and has none."""
    first, out = keyframes[0], list[float]()
    T_world = torch.from_numpy(first.T_wk @ np.linalg.inv(truth[first.index]))
    for k in keyframes[1:]:
        assert k.covariance is not None
        off = se3.log(torch.from_numpy(np.linalg.inv(k.T_wk)) @ T_world @ torch.from_numpy(truth[k.index])).numpy()
        out.append(float(off @ np.linalg.solve(k.covariance, off)) / 6)
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", default=["synthetic:kinect"])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--frames", type=int, default=300)
    parser.add_argument("--size", default="320x240")
    arguments = parser.parse_args()
    width, height = map(int, arguments.size.split("x"))
    torch.set_num_threads(1)
    print("| scene | seeds | keyframes | NEES mean | median | before [cm] | after [cm] | not adjusted |\n|---|" + "---:|" * 7, flush=True)
    for scene in arguments.scenes:
        squares, before, after, refused = list[float](), list[float](), list[float](), 0
        for seed in range(arguments.seeds):
            recording, slam = opened(scene, seed, arguments.frames, (width, height)), Slam(replace(FAST, seed=seed, calibrate="off"))
            for frame, _ in read_frames(recording):
                slam.process(frame)
            truth = np.asarray(recording.ground_truth)
            before.append(positions_off(slam.stored_keyframes(), truth))
            slam.finish()
            after.append(positions_off(slam.stored_keyframes(), truth))
            if slam.figures()["keyframes_adjusted"]:
                squares += squared_errors(slam.stored_keyframes(), truth)
            else:
                refused += 1
        nees = f"{np.mean(squares):.2f} | {np.median(squares):.2f}" if squares else "- | -"
        errors = f"{np.mean(before):.2f} | {np.mean(after):.2f}"
        print(f"| {scene} | {arguments.seeds} | {len(squares)} | {nees} | {errors} | {refused} |", flush=True)


if __name__ == "__main__":
    main()
