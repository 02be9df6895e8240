"""Open3D's dense frame-to-model SLAM (`open3d.t.pipelines.slam`) on the CPU: voxel blocks, each frame aligned to the rendered model."""

from idfslam.benchmark.peers.external_program import run_program
from idfslam.benchmark.peers.peer import Peer, PeerJob, PeerRun, has_package
from idfslam.errors import pip_install


def open3d_missing(python: str) -> str | None:
    """How to install Open3D for this Python; None if it is there."""
    return None if has_package(python, "open3d") else f"Open3D is not installed: {pip_install('open3d', python=python)}"


class Open3d(Peer):
    """Its example dense_slam, with its values."""

    name = "open3d"
    about = "Open3D's dense frame-to-model SLAM with the values of its example (MIT)"

    def missing(self, python: str) -> str | None:
        return open3d_missing(python)

    def run(self, job: PeerJob) -> PeerRun:
        return run_program(job, "open3d_program", ["slam"])
