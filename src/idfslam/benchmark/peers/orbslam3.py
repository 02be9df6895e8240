"""ORB-SLAM3 with depth (Campos et al., T-RO 2021), by the package pyorbslam3, in a process of its own. Its vocabulary is learnt here."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from idfslam.benchmark.peers.external_program import run_program
from idfslam.benchmark.peers.orb_vocabulary import recorded_descriptors, write_vocabulary
from idfslam.benchmark.peers.peer import Peer, PeerError, PeerJob, PeerRun, has_package
from idfslam.datasets import Dataset
from idfslam.errors import pip_install
from idfslam.geometry.camera import Camera
from idfslam.geometry.trajectory import Trajectory, load_tum

_PACKAGE = "pyorbslam3"  # in no extra of ours: GPL-3
_BASELINE = 40.0  # [px m] of the stereo pair that depth is turned into, as in ORB-SLAM3's file for TUM; larger: depth is trusted farther
_SETTINGS = """%YAML:1.0
File.version: "1.0"
Camera.type: "PinHole"
Camera1.fx: {camera.fx:.6f}
Camera1.fy: {camera.fy:.6f}
Camera1.cx: {camera.cx:.6f}
Camera1.cy: {camera.cy:.6f}
Camera1.k1: 0.0
Camera1.k2: 0.0
Camera1.p1: 0.0
Camera1.p2: 0.0
Camera.width: {camera.width}
Camera.height: {camera.height}
Camera.fps: {fps}
Camera.RGB: 1
Stereo.ThDepth: 40.0
Stereo.b: {baseline:.6f}
RGBD.DepthMapFactor: 1.0
ORBextractor.nFeatures: 1000
ORBextractor.scaleFactor: 1.2
ORBextractor.nLevels: 8
ORBextractor.iniThFAST: 20
ORBextractor.minThFAST: 7
Viewer.KeyFrameSize: 0.05
Viewer.KeyFrameLineWidth: 1.0
Viewer.GraphLineWidth: 0.9
Viewer.PointSize: 2.0
Viewer.CameraSize: 0.08
Viewer.CameraLineWidth: 3.0
Viewer.ViewpointX: 0.0
Viewer.ViewpointY: -0.7
Viewer.ViewpointZ: -1.8
Viewer.ViewpointF: 500.0
"""


class OrbSlam3(Peer):
    """With the values of its files for TUM RGB-D. Frames are given to it as fast as it takes them."""

    name = "orbslam3"
    about = (
        "ORB-SLAM3 with depth and the values of its TUM files, by pyorbslam3 in a process of its own; vocabulary from the recording (GPL-3)"
    )

    def missing(self, python: str) -> str | None:
        return None if has_package(python, _PACKAGE) else f"{_PACKAGE} is not installed: {pip_install(_PACKAGE, python=python)}"

    def run(self, job: PeerJob) -> PeerRun:
        vocabulary, settings, trajectory = (job.folder / name for name in ("vocabulary.txt", "settings.yaml", "trajectory.txt"))
        write_vocabulary(vocabulary, recorded_descriptors(job.recording), job.seed)
        settings.write_text(settings_of(job.recording.camera, job.recording), encoding="ascii")
        run = run_program(job, "orbslam3_program", after=[str(vocabulary), str(settings), str(trajectory)])
        if not np.isfinite(run.poses).any():
            raise PeerError("it never began to track: it needs 500 ORB features with depth in one frame")
        return PeerRun(corrected(trajectory, job.recording.timestamps, run.poses), run.seconds, run.version, run.peak_memory_mb)


def settings_of(camera: Camera, recording: Dataset) -> str:
    """ORB-SLAM3's settings for a camera without distortion and depth in metres."""
    steps = np.diff(recording.timestamps)
    fps = max(1, round(1 / float(np.median(steps)))) if len(steps) else 30
    return _SETTINGS.format(camera=camera, baseline=_BASELINE / camera.fx, fps=fps)


def corrected(path: Path, timestamps: NDArray[np.float64], tracked: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N, 4, 4) the exported poses of the frames, NaN where a frame was lost or is not in the file (which rounds stamps to 1 us)."""
    exported: Trajectory = load_tum(path)
    frames = np.abs(timestamps[:, None] - exported.timestamps).argmin(1)
    near = np.abs(timestamps - exported.timestamps[frames]) < 1e-4
    kept = near & np.isfinite(tracked).all((1, 2))
    return np.where(kept[:, None, None], exported.poses[frames], np.nan)
