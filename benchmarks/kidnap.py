"""A camera carried off in the dark: how soon is it found again, and how well?

    python benchmarks/kidnap.py RECORDING [SEED ...]

Each recording (any with ground truth) is interrupted five times by 30 black frames, after which it goes on from somewhere seen before.
"""

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from idfslam.compute.process import prepare_process

prepare_process()

import torch  # noqa: E402

from idfslam.config import FAST  # noqa: E402
from idfslam.datasets import Kidnapped, open_recording  # noqa: E402
from idfslam.evaluation.trajectory_error import absolute_trajectory_error  # noqa: E402
from idfslam.frame import Status  # noqa: E402
from idfslam.runs.source import read_frames  # noqa: E402
from idfslam.slam import Slam  # noqa: E402


def waits(statuses: Sequence[Status], order: np.ndarray) -> Iterator[int | None]:
    """For each darkness, how many frames with light passed before the camera was found; None where it never was."""
    ends = np.flatnonzero((order[:-1] < 0) & (order[1:] >= 0)) + 1
    for first, last in zip(ends, [*(ends[1:] - 1), len(order)]):
        found = [i for i in range(first, last) if order[i] >= 0 and statuses[i] is not Status.LOST]
        yield found[0] - first if found else None


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording", help="with ground truth")
    parser.add_argument("seeds", type=int, nargs="*", default=[0])
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    for seed in arguments.seeds:
        recording, slam = Kidnapped(open_recording(arguments.recording), seed=seed), Slam(replace(FAST, seed=seed))
        live = [slam.process(frame).status for frame, _ in read_frames(recording)]
        slam.finish()
        assert recording.ground_truth is not None
        kept = [i for i, status in enumerate(slam.statuses()) if status.measured]
        ate = absolute_trajectory_error(slam.trajectory()[kept], recording.ground_truth[kept]).translation
        told = " ".join("never" if wait is None else str(wait) for wait in waits(live, recording.order))
        print(
            f"{recording.name}, seed {seed}: found after {told} frames; ATE of {len(kept)} found frames {100 * ate.rmse:.2f} cm", flush=True
        )


if __name__ == "__main__":
    main()
