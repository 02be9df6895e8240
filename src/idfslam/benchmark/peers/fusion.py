"""Plain TSDF fusion at the poses of our run (Curless and Levoy, SIGGRAPH 1996), by Open3D's VoxelBlockGrid: what a neural map must beat."""

from idfslam.benchmark.peers.external_program import run_program
from idfslam.benchmark.peers.open3d import open3d_missing
from idfslam.benchmark.peers.peer import Peer, PeerError, PeerJob, PeerRun
from idfslam.evaluation.depth_range import depth_range


class Fusion(Peer):
    """All frames in one grid of 1 cm, as far as the sensor reads."""

    name = "fusion"
    about = "our poses and plain TSDF fusion of all frames at 1 cm, by Open3D (MIT): the surface alone is its own"
    takes_poses = True

    def missing(self, python: str) -> str | None:
        return open3d_missing(python)

    def run(self, job: PeerJob) -> PeerRun:
        if job.poses is None:
            raise PeerError("fusion has no poses: our own run failed")
        readings = depth_range(job.recording)
        if readings is None:
            raise PeerError(f"{job.recording.name}: has no depth, so there is nothing to fuse")
        return run_program(job, "open3d_program", ["fuse"], [str(readings.far)])
