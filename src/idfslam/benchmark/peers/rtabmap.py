"""RTAB-Map with RGB-D (Labbé and Michaud, JFR 2019), by its command line `rtabmap-rgbd_dataset`, where that is installed.

The program reads folders of images, with stamps as their names, and knows three cameras by the folder's name, those of TUM RGB-D. So the
frames are resampled to the third of them, a pinhole camera without distortion.
"""

import re
import shutil
import subprocess
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from idfslam.batch.executor import last_line
from idfslam.benchmark.peers.peer import Peer, PeerError, PeerJob, PeerRun
from idfslam.geometry.camera import Camera
from idfslam.geometry.trajectory import Trajectory, load_tum
from idfslam.runs.source import read_frames

PROGRAM = "rtabmap-rgbd_dataset"
_CAMERA = Camera(640, 480, 535.4, 539.2, 320.1, 247.6)  # which the program has for folders named freiburg3
_SEQUENCE = "rgbd_dataset_freiburg3"
_UNITS = 5000  # per metre of its depth images; fixed by the program
# As its authors run it on TUM, and with a node, and so a pose, for every frame
_OPTIONS = ("--Rtabmap/DetectionRate", "2", "--RGBD/LinearUpdate", "0", "--Mem/STMSize", "30", "--Rtabmap/CreateIntermediateNodes", "true")


class RtabMap(Peer):
    """Its default odometry and loop closure."""

    name = "rtabmap"
    about = "RTAB-Map's default RGB-D odometry and loop closure by its command line, on frames resampled to TUM's third camera (BSD)"

    def missing(self, python: str) -> str | None:
        if shutil.which(PROGRAM):
            return None
        return f"{PROGRAM} is not installed: it is part of RTAB-Map (Debian, Ubuntu: apt install rtabmap, or ros-DISTRO-rtabmap)"

    def run(self, job: PeerJob) -> PeerRun:
        sequence, out = job.folder / _SEQUENCE, job.folder / "out"
        _write_frames(sequence, job)
        command = [PROGRAM, *_OPTIONS, "--output", str(out), str(sequence)]
        done = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
        if done.returncode:
            raise PeerError(last_line(done.stderr or done.stdout, done.returncode))
        seconds = re.search(r"Total time=([\d.]+)s", done.stdout)
        poses = out / "rtabmap_poses.txt"
        if seconds is None or not poses.is_file():
            raise PeerError(f"{PROGRAM} wrote no poses: it never began to track, or its output has another form than that of version 0.20")
        version = re.search(r"RTAB-Map version: (\S+)", done.stdout)
        found = of_frames(load_tum(_eight_columns(poses)), job.recording.timestamps)
        return PeerRun(found, float(seconds[1]), version[1] if version else "unknown")


def _write_frames(sequence: Path, job: PeerJob) -> None:
    colours, depths = sequence / "rgb_sync", sequence / "depth_sync"
    for folder in (colours, depths):
        folder.mkdir(parents=True)
    for frame, _ in read_frames(job.recording):
        colour, depth = resampled(frame.colour, frame.depth, frame.camera)
        name = f"{frame.timestamp:.6f}.png"
        cv2.imwrite(str(colours / name), cv2.cvtColor(np.round(colour * 255).astype(np.uint8), cv2.COLOR_RGB2BGR))
        cv2.imwrite(str(depths / name), np.minimum(np.round(depth * _UNITS), np.iinfo(np.uint16).max).astype(np.uint16))


def resampled(colour: NDArray[np.float32], depth: NDArray[np.float32], camera: Camera) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Colour (480, 640, 3) and depth (480, 640) [m] as the program's camera would have seen them; depth by the nearest pixel."""
    u, v = np.meshgrid(np.arange(_CAMERA.width), np.arange(_CAMERA.height))
    x = ((u - _CAMERA.cx) / _CAMERA.fx * camera.fx + camera.cx).astype(np.float32)
    y = ((v - _CAMERA.cy) / _CAMERA.fy * camera.fy + camera.cy).astype(np.float32)
    taken = cv2.remap(colour, x, y, cv2.INTER_LINEAR), cv2.remap(depth, x, y, cv2.INTER_NEAREST)
    return np.asarray(taken[0], np.float32), np.asarray(taken[1], np.float32)


def _eight_columns(path: Path) -> Path:
    """The same poses without the column of node numbers that newer versions add."""
    lines = path.read_text(encoding="utf-8").splitlines()
    path.write_text("\n".join(" ".join(line.split()[:8]) for line in lines if not line.startswith("#")), encoding="utf-8")
    return path


def of_frames(found: Trajectory, timestamps: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N, 4, 4) the poses of the frames, NaN where none has the frame's stamp to 0.1 ms. Camera centres count: the axes are RTAB-Map's."""
    nearest = np.abs(timestamps[:, None] - found.timestamps).argmin(1)
    near = np.abs(timestamps - found.timestamps[nearest]) < 1e-4
    return np.where(near[:, None, None], found.poses[nearest], np.nan)
