"""A camera carried in the dark to where it has never been: does it map that on its own, and does that come to lie where it belongs?

    python benchmarks/submaps.py RECORDING FRAME NEXT [RECORDING FRAME NEXT ...]

The recording (any with ground truth that comes back to where it began) goes up to FRAME; after 30 black frames it goes on from NEXT.
"""

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from idfslam.compute.process import prepare_process

prepare_process()

import torch  # noqa: E402

from idfslam.config import FAST  # noqa: E402
from idfslam.datasets import Dataset, open_recording  # noqa: E402
from idfslam.evaluation.trajectory_error import absolute_trajectory_error  # noqa: E402
from idfslam.frame import Frame, Status  # noqa: E402
from idfslam.slam import Slam  # noqa: E402

DARK = 30


def shown(recording: Dataset, order: Sequence[int]) -> Iterator[Frame]:
    """The recording's frames in that order; -1: a black one."""
    for i, j in enumerate(order):
        frame = Frame.blank(0, 0.0, recording.camera) if j < 0 else recording[j]
        yield replace(frame, index=i, timestamp=i / 30)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("walks", nargs="+", metavar="RECORDING FRAME NEXT")
    walks = parser.parse_args().walks
    if len(walks) % 3 or not all(number.isdigit() for i, number in enumerate(walks) if i % 3):
        parser.error(f"found {' '.join(walks)}, expected RECORDING FRAME NEXT, once or several times")
    torch.set_num_threads(1)
    for name, first, after in zip(walks[::3], map(int, walks[1::3]), map(int, walks[2::3])):
        recording, slam = open_recording(name), Slam(FAST)
        truth = np.asarray(recording.ground_truth)
        order = [*range(first), *[-1] * DARK, *range(after, len(recording))]
        live = [slam.process(frame).status for frame in shown(recording, order)]
        slam.finish()
        statuses = slam.statuses()
        found = [i for i, j in enumerate(order) if j >= 0 and statuses[i].measured]
        error = absolute_trajectory_error(slam.trajectory()[found], truth[[order[i] for i in found]]).translation
        lost = [i for i, status in enumerate(live) if status is Status.LOST]
        told = f"told as lost from frame {lost[0]} to {lost[-1]}" if lost else "never lost"
        figures = {name: slam.figures()[name] for name in ("submaps", "submaps_merged", "relocalisations")}
        ate = f"ATE of {len(found)} found of {len(order)} frames {100 * error.rmse:.2f} cm"
        print(f"{name}, {first} to {after}: {told}; {figures}; {ate}", flush=True)


if __name__ == "__main__":
    main()
