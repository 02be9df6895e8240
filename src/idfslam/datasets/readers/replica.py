"""Replica as rendered for iMAP and NICE-SLAM: results/frameNNNNNN.jpg, results/depthNNNNNN.png, traj.txt, cam_params.json."""

from pathlib import Path

from idfslam.datasets.cameras.calibration import Calibration
from idfslam.datasets.cameras.camera_files import read_cam_params, read_depth_camera
from idfslam.datasets.images.decoding import ImageFiles, numbered
from idfslam.datasets.images.depth_units import usual_scale
from idfslam.datasets.images.pairs import paired
from idfslam.datasets.near_miss import Likeness, part
from idfslam.datasets.provenance import ASSUMED
from idfslam.datasets.readers.folder import read_trajectory
from idfslam.datasets.recording import FPS, Reader, Recording

PUBLISHED = Calibration(600.0, 600.0, 599.5, 339.5, 1200, 680, source="the published camera of Replica")


def recognises(path: Path) -> bool:
    """Images in results/ decide: a folder of that name is also where `idf-slam run` writes to."""
    return any(file.is_file() for name in ("frame*", "depth*") for file in (path / "results").glob(name))


def open_replica(path: Path, stated: Calibration) -> Recording:
    """Opens a scene; cam_params.json is in the folder or, as published, in its parent."""
    images = path / "results"
    pairs = paired(numbered(images, "frame*"), numbered(images, "depth*"), images)
    of_scene = stated.over(read_cam_params(path.parent))
    return Recording(
        path.name,
        ImageFiles(pairs.files),
        timestamps=pairs.places / FPS,
        depth_timestamps=pairs.depth_timestamps(pairs.places / FPS),
        stamps_source=ASSUMED,
        ground_truth=lambda: read_trajectory(path / "traj.txt", pairs, pairs.places / FPS),
        calibration=of_scene.over(PUBLISHED).over(usual_scale(pairs.files, 6553.5, "Replica layout")),
        depth_camera=read_depth_camera(path),
    )


READER = Reader(
    "replica",
    "results/frame*.jpg, results/depth*.png",
    recognises,
    open_replica,
    likeness=Likeness("a Replica scene", (part("results", "results/"),)),
)
