"""Loops in generated corridors (or any recording with ground truth): error with and without, at the end, and wrong loops.

    python benchmarks/loops.py corridor:0:kinect corridor:1:kinect:2laps [--without] [--frames N] [loops.drift=0.05 ...]

A loop is wrong if its measured relation is more than 10 cm or 3 degrees off the truth. A link is an edge of the graph between keyframes of
one place with at least 10 m of walk between them: a keyframe that has one lies on what was mapped there before. It is wrong likewise.
"""

import argparse
import math
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

_APART = 10.0  # [m] of walk between keyframes of a link
_SAME_PLACE, _SAME_VIEW = 1.0, 0.8  # [m] between keyframes that show the same, and least cosine between their directions


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
        if _is_off(error):
            yield loop


def _is_off(error: torch.Tensor) -> bool:
    return float(error[:3, 3].norm()) > 0.1 or math.degrees(float(se3.angle(error))) > 3


def links(slam: Slam, truth: np.ndarray) -> tuple[int, int, int]:
    """How many stored keyframes have a link, how many come where others were 10 m of walk before, and how many links are wrong."""
    walked = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(truth[:, :3, 3], axis=0), axis=1))])
    keyframes = slam.graph.keyframes
    at, places = np.array([walked[k.index] for k in keyframes]), truth[[k.index for k in keyframes]]
    linked = again = off = 0
    for b, keyframe in enumerate(keyframes):
        before = np.flatnonzero(at[b] - at > _APART)
        near = np.linalg.norm(places[before, :3, 3] - places[b, :3, 3], axis=1) < _SAME_PLACE
        ahead = places[before, :3, 2] @ places[b, :3, 2] > _SAME_VIEW
        edges = sorted(set(before.tolist()) & keyframe.edges)
        again += bool((near & ahead).any())
        linked += bool(edges)
        for a in edges:
            true = torch.from_numpy(np.linalg.inv(places[b]) @ places[a])
            off += _is_off(true @ se3.inverse(keyframes[a].T_wk) @ keyframe.T_wk)
    return linked, again, off


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recordings", nargs="+", help="recordings with ground truth, and section.value=... of the configuration")
    parser.add_argument("--without", action="store_true", help="without loops")
    parser.add_argument("--frames", type=int, help="number of frames of each recording; default: all")
    arguments = parser.parse_args()
    values = [word for word in arguments.recordings if "=" in word]
    config = configured(values + (["loops.enabled=false"] if arguments.without else []))
    torch.set_num_threads(1)
    for name in (word for word in arguments.recordings if word not in values):
        recording, slam = open_recording(name, frames=arguments.frames), Slam(config)
        truth = np.asarray(recording.ground_truth)
        for frame, _ in read_frames(recording):
            slam.process(frame)
        slam.finish()
        poses = slam.trajectory()
        live, ate = (absolute_trajectory_error(T, truth).translation.rmse for T in (slam.live_trajectory(), poses))
        end = np.linalg.norm((np.linalg.inv(poses[0]) @ poses[-1] - np.linalg.inv(truth[0]) @ truth[-1])[:3, 3])
        connections, (linked, again, off) = slam.figures(), links(slam, truth)
        print(
            f"{name}: {len(poses)} frames, ATE {100 * ate:.2f} cm, live {100 * live:.2f} cm, end {100 * end:.1f} cm, "
            f"{len(connections['loops'])} loops, {len(list(wrong(slam, list(slam.loops()), truth)))} wrong, "
            f"{connections['loops_refused']} refused, {len(slam.graph.keyframes)} keyframes, "
            f"{again} where others were before, {linked} linked, {off} links wrong, "
            f"{sum(s.value in ('lost', 'interpolated') for s in slam.statuses())} lost",
            flush=True,
        )


if __name__ == "__main__":
    main()
