"""Replica as rendered for iMAP and NICE-SLAM: results/frameNNNNNN.jpg, results/depthNNNNNN.png, traj.txt, cam_params.json."""

from pathlib import Path

from idfslam.datasets.calibration import Calibration, read_cam_params
from idfslam.datasets.images import ImageFiles, numbered, paired
from idfslam.datasets.provenance import ASSUMED
from idfslam.datasets.readers.folder import read_trajectory
from idfslam.datasets.recording import Reader, Recording, regular_stamps

PUBLISHED = Calibration(600.0, 600.0, 599.5, 339.5, 1200, 680, depth_scale=6553.5, source="Replica, as published")


def recognises(path: Path) -> bool:
    return (path / "results").is_dir()


def open_replica(path: Path, override: Calibration) -> Recording:
    """Opens a scene; cam_params.json is in the folder or, as published, in its parent."""
    images = path / "results"
    pairs = paired(numbered(images, "frame*"), numbered(images, "depth*"), images)
    return Recording(
        path.name,
        ImageFiles(pairs),
        timestamps=regular_stamps(len(pairs)),
        stamps_source=ASSUMED,
        ground_truth=read_trajectory(path / "traj.txt", len(pairs)),
        calibration=override.over(read_cam_params(path, path.parent)).over(PUBLISHED),
    )


READER = Reader("replica", "results/frame*.jpg, results/depth*.png", recognises, open_replica)
