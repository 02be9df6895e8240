"""Loops in generated corridors (or any recording with ground truth): error with and without, at the end, and wrong loops.

    python benchmarks/loops.py corridor:0:kinect corridor:1:kinect [--without] [loops.drift=0.05 ...]

A loop is wrong if its measured relation is more than 10 cm or 3 degrees off the truth.
"""

import math
import sys
from collections.abc import Iterator

import numpy as np

from idfslam.compute.process import prepare_process

prepare_process()

import torch  # noqa: E402
import yaml  # noqa: E402

from idfslam.config import FAST, Config, update  # noqa: E402
from idfslam.datasets import open_recording  # noqa: E402
from idfslam.evaluation.trajectory_error import absolute_trajectory_error  # noqa: E402
from idfslam.geometry import se3  # noqa: E402
from idfslam.graph.loop_consistency import Loop  # noqa: E402
from idfslam.runs.source import read_frames  # noqa: E402
from idfslam.slam import Slam  # noqa: E402


def configured(arguments: list[str]) -> Config:
    """The default preset with `section.value=...` of the command line."""
    config = FAST
    for argument in arguments:
        path, value = argument.split("=")
        nested = yaml.safe_load(value)
        for part in reversed(path.split(".")):
            nested = {part: nested}
        config = update(config, nested, "the command line")
    return config


def wrong(slam: Slam, loops: list[Loop], truth: np.ndarray) -> Iterator[Loop]:
    """The loops that the truth (N, 4, 4) contradicts."""
    for loop in loops:
        a, b = (torch.from_numpy(truth[slam.graph.keyframes[i].index]) for i in (loop.a, loop.b))
        error = se3.inverse(loop.T_ab) @ se3.inverse(a) @ b
        if float(error[:3, 3].norm()) > 0.1 or math.degrees(float(se3.angle(error))) > 3:
            yield loop


def main() -> None:
    arguments = sys.argv[1:]
    names = [a for a in arguments if "=" not in a and a != "--without"]
    config = configured([a for a in arguments if "=" in a] + (["loops.enabled=false"] if "--without" in arguments else []))
    torch.set_num_threads(1)
    for name in names:
        recording, slam = open_recording(name), Slam(config)
        truth = np.asarray(recording.ground_truth)
        for frame, _ in read_frames(recording):
            slam.process(frame)
        slam.finish()
        poses = slam.trajectory()
        live, ate = (absolute_trajectory_error(T, truth).translation.rmse for T in (slam.live_trajectory(), poses))
        end = np.linalg.norm((np.linalg.inv(poses[0]) @ poses[-1] - np.linalg.inv(truth[0]) @ truth[-1])[:3, 3])
        connections = slam.figures()
        print(
            f"{name}: {len(poses)} frames, ATE {100 * ate:.2f} cm, live {100 * live:.2f} cm, end {100 * end:.1f} cm, "
            f"{len(connections['loops'])} loops, {len(list(wrong(slam, list(slam.loops()), truth)))} wrong, "
            f"{connections['loops_refused']} refused, {len(slam.graph.keyframes)} keyframes, "
            f"{sum(s.value in ('lost', 'interpolated') for s in slam.statuses())} lost",
            flush=True,
        )


if __name__ == "__main__":
    main()
