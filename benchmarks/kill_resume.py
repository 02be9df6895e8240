"""Kills runs at random moments with SIGKILL and goes on with them: does each end with the trajectory of a run that was left alone?

python benchmarks/kill_resume.py [KILLS] [--seed N] [--frames N] [--every N]

The recording is a generated room of 160 x 120 pixels. A run is killed again and again, at moments that are drawn evenly from the start of
its process to a third of an unbroken run later, until it is over before its next death; then another one begins, until all kills are
spent. Processes are forked from one that has imported everything, so that deaths fall into the run and not into its imports.
"""

# ruff: noqa: E402
from idfslam.compute.process import prepare_process

prepare_process()  # before torch or numba is imported

import argparse
import json
import random
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from multiprocessing import get_context
from pathlib import Path

import cv2
import numpy as np

import idfslam.runs.runner  # noqa: F401 (imported here for all processes)
from idfslam.cli import command_line
from idfslam.datasets.generated.room import SyntheticRoom
from idfslam.frame import Frame
from idfslam.runs import result_folder
from idfslam.runs.run_folder import is_unfinished

COMPARED = (result_folder.TRAJECTORY, result_folder.KEYFRAMES, result_folder.MESH, result_folder.MAP)  # byte by byte


def write_room(folder: Path, frames: int) -> Path:
    """A generated room as a plain folder, so that frames are read and not rendered."""
    room = SyntheticRoom(0, frames, 160, 120)
    for name in ("rgb", "depth"):
        (folder / name).mkdir(parents=True)
    for i in range(frames):
        frame: Frame = room[i]
        cv2.imwrite(str(folder / "rgb" / f"{i:04d}.png"), (frame.colour[..., ::-1] * 255).round().astype(np.uint8))
        cv2.imwrite(str(folder / "depth" / f"{i:04d}.png"), (frame.depth * 1000).round().astype(np.uint16))
    np.savetxt(folder / "intrinsics.txt", room.camera.matrix().numpy())
    return folder


def in_process(task: Callable[..., object], *arguments: object, wait: float | None = None) -> bool:
    """Runs a task in a process of its own; False where it was killed after `wait` seconds. Ends the benchmark where it fails."""
    process = get_context("fork").Process(target=task, args=arguments)
    process.start()
    process.join(wait)
    if process.exitcode is None:
        process.kill()
        process.join()
        return False
    if process.exitcode:
        sys.exit(f"{arguments} ended with {process.exitcode}")
    return True


def idf_slam(*arguments: object) -> None:
    """`idf-slam run`, silently."""
    with Path("/dev/null").open("w") as nowhere, redirect_stdout(nowhere), redirect_stderr(nowhere):
        command_line.main(["run", *map(str, arguments)])


def stage(folder: Path) -> str:
    """What the last checkpoint, or its absence, says of a run that was just killed."""
    if (folder / result_folder.METRICS).exists():
        return "results written"
    if not (folder / result_folder.CHECKPOINT).exists():
        return "no checkpoint yet" if is_unfinished(folder) else "not begun"
    half = (folder / f".part-{result_folder.CHECKPOINT}").exists()
    return "while one was written" if half else "after a checkpoint"


def differing(folder: Path, whole: Path) -> list[str]:
    """The results of a run that are not those of the unbroken one."""
    return [name for name in COMPARED if (folder / name).read_bytes() != (whole / name).read_bytes()]


def main() -> None:
    """Prints what each kill met, and how many runs ended as the unbroken one."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kills", type=int, nargs="?", default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--frames", type=int, default=150)
    parser.add_argument("--every", type=int, default=10)
    arguments = parser.parse_args()
    chance = random.Random(arguments.seed)
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        recording, mesh = place / "room", ("--mesh.resolution", 0.05)
        in_process(write_room, recording, arguments.frames)
        in_process(idf_slam, recording, "--frames", 12, *mesh, "--out", place / "compiled")  # all that follow run the same compiled code
        begun, every = time.perf_counter(), ("--checkpoint-every", arguments.every)
        in_process(idf_slam, recording, *every, *mesh, "--out", place / "whole")
        seconds = time.perf_counter() - begun
        print(f"{arguments.frames} frames without a break: {seconds:.1f} s, a checkpoint every {arguments.every} frames", flush=True)
        kills = runs = equal = 0
        while kills < arguments.kills:
            folder, runs = place / f"run{runs}", runs + 1
            while True:
                flags = ("--resume", folder) if is_unfinished(folder) else (recording, *mesh, "--out", folder)
                wait = chance.uniform(0, seconds / 3) if kills < arguments.kills else None
                if in_process(idf_slam, *flags, *every, wait=wait):
                    break
                kills += 1
                print(f"kill {kills}, of run {runs}, after {wait:.1f} s: {stage(folder)}", flush=True)
            other = differing(folder, place / "whole")
            resumed = json.loads((folder / result_folder.METRICS).read_text())["resumed_at"]
            print(f"run {runs}: went on after frames {resumed}, {f'OTHER {other}' if other else 'the same to the last bit'}", flush=True)
            equal += not other
        print(f"{kills} kills in {runs} runs: {equal} of {runs} ended as the unbroken run")
    if equal < runs:
        sys.exit(1)


if __name__ == "__main__":
    main()
