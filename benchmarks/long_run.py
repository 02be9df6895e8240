"""A long run: memory, speed and error by every thousand frames, as a table and a picture.

    python benchmarks/long_run.py corridor:0:kinect 10000 [OUT.png]

Speed counts `Slam.process` alone, with nothing beside it: generated frames are rendered before, so many at a time.
"""

import argparse
import os
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from idfslam.compute.process import prepare_process

prepare_process()

import torch  # noqa: E402

from idfslam.datasets import Dataset, open_recording  # noqa: E402
from idfslam.evaluation.trajectory_error import absolute_trajectory_error  # noqa: E402
from idfslam.frame import Frame  # noqa: E402
from idfslam.slam import Slam  # noqa: E402

EVERY = 1000
AT_A_TIME = 50


def in_blocks(recording: Dataset) -> Iterator[Frame]:
    """All frames in order; while one is being processed, none is being rendered or decoded."""
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for first in range(0, len(recording), AT_A_TIME):
            yield from list(pool.map(recording.__getitem__, range(first, min(first + AT_A_TIME, len(recording)))))


def memory() -> float:
    """Resident memory of this process [MiB], by Linux."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording", help="with ground truth")
    parser.add_argument("frames", type=int)
    parser.add_argument("picture", type=Path, nargs="?", help="a file to write")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    recording, slam = open_recording(arguments.recording, frames=arguments.frames), Slam()
    truth = np.asarray(recording.ground_truth)
    rows: list[tuple[float, ...]] = []
    seconds, before = 0.0, dict[str, float]()
    print("frames | frames/s | memory [MiB] | keyframes | loops | ATE so far [cm] | ms a frame by stage ('map' beside the others)")
    for i, frame in enumerate(in_blocks(recording), start=1):
        start = time.perf_counter()
        slam.process(frame)
        seconds += time.perf_counter() - start
        if i % EVERY == 0 or i == len(recording):
            ate = absolute_trajectory_error(slam.trajectory(), truth[:i]).translation.rmse
            frames_in = i - int(rows[-1][0]) if rows else i
            rows.append((i, frames_in / seconds, memory(), len(slam.graph.keyframes), len(slam.loops()), 100 * ate))
            spent = {stage: sum(times) for stage, times in slam.timings.items()}
            stages = ", ".join(f"{stage} {(ms - before.get(stage, 0.0)) / frames_in:.1f}" for stage, ms in spent.items())
            print("{:.0f} | {:.2f} | {:.0f} | {:.0f} | {:.0f} | {:.2f}".format(*rows[-1]), "|", stages, flush=True)
            seconds, before = 0.0, spent
    if arguments.picture is not None:
        draw(arguments.picture, np.array(rows))


def draw(path: Path, rows: np.ndarray) -> None:
    """Speed, memory and error over the frames (R, 6)."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 3.2), dpi=130, layout="constrained")
    for plot, column, label in zip(figure.subplots(1, 3), (1, 2, 5), ("frames/s", "memory [MiB]", "ATE so far [cm]")):
        plot.plot(rows[:, 0], rows[:, column], marker="o", markersize=3)
        plot.set(xlabel="frames", ylabel=label, ylim=(0, None))
        plot.grid(alpha=0.3)
    figure.savefig(path)


if __name__ == "__main__":
    main()
