"""ORB-SLAM3 on a stream of frames, by the package pyorbslam3. A program of its own, since ORB-SLAM3 is under the GPL.

    PYTHON orbslam3_program.py RESULT.npz VOCABULARY SETTINGS TRAJECTORY < STREAM

TRAJECTORY gets what ORB-SLAM3 exports at its end: the poses of tracked frames after all corrections, as lines of TUM. RESULT.npz has the
poses as they were tracked. Only ORB-SLAM3's calls are timed, the loading of the vocabulary not.
"""

import os
import sys
from importlib.metadata import version
from pathlib import Path
from time import perf_counter

import numpy as np
import pyorbslam3
from frame_stream import read_frames, read_header
from result_file import ProgramResult, peak_memory, write_result


def main(result: Path, vocabulary: str, settings: str, trajectory: str) -> None:
    """Tracks all frames, then writes the trajectory and the result."""
    header = read_header(sys.stdin.buffer)
    system = pyorbslam3.Slam(vocabulary, settings, pyorbslam3.Sensor.RGBD, use_viewer=False)
    poses, seconds = [], 0.0
    for frame in read_frames(sys.stdin.buffer, header):
        began = perf_counter()
        found = system.track_rgbd(frame.colour, frame.depth, frame.timestamp)
        seconds += perf_counter() - began
        poses.append(np.array(found.pose_wc) if found.ok else np.full((4, 4), np.nan))
    began = perf_counter()
    system.shutdown()
    if np.isfinite(poses).any():  # with an empty map its export ends the process
        system.save_trajectory_tum(trajectory)
    seconds += perf_counter() - began
    nothing = np.zeros((0, 3)), np.zeros((0, 3), np.int64)
    write_result(result, ProgramResult(np.array(poses), seconds, version("pyorbslam3"), peak_memory(), *nothing))


if __name__ == "__main__":
    main(Path(sys.argv[1]), *sys.argv[2:])
    os._exit(0)  # its threads may still hold what the interpreter would take down
