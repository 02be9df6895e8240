"""7-Scenes: seq-XX/frame-NNNNNN.{color.png,depth.png,pose.txt}; depth in millimetres, 65535 = no reading.

The published depth is not registered to the colour camera; like the field, this reader uses the depth camera for both.
"""

from pathlib import Path

from idfslam.datasets.calibration import Calibration, read_cam_params
from idfslam.datasets.folder import read_pose_files
from idfslam.datasets.images import ImageFiles, numbered, paired
from idfslam.datasets.recording import Reader, Recording, regular_stamps
from idfslam.errors import RecordingError

PUBLISHED = Calibration(585.0, 585.0, 320.0, 240.0, 640, 480, depth_scale=1000, source="7-Scenes, as published")


def recognises(path: Path) -> bool:
    return any(path.glob("frame-*.color.png")) or any(path.glob("seq-*/frame-*.color.png"))


def open_seven_scenes(path: Path, override: Calibration) -> Recording:
    """A sequence's folder, or a scene's where it holds one sequence only."""
    path = _sequence(path)
    pairs = paired(numbered(path, "frame-*.color.png"), numbered(path, "frame-*.depth.png"), path)
    return Recording(
        f"{path.parent.name}-{path.name}",
        ImageFiles(pairs),
        timestamps=regular_stamps(len(pairs)),
        ground_truth=read_pose_files(sorted(path.glob("frame-*.pose.txt")), len(pairs)),
        calibration=override.over(read_cam_params(path, path.parent)).over(PUBLISHED),
    )


def _sequence(path: Path) -> Path:
    if any(path.glob("frame-*")):
        return path
    sequences = sorted({file.parent.name for file in path.glob("seq-*/frame-*")})
    if len(sequences) != 1:
        found = f"{len(sequences)} sequences ({', '.join(sequences)})" if sequences else "no frame-NNNNNN.color.png"
        raise RecordingError(f"{path}: {found}: name the folder of one sequence, {path / (sequences or ['seq-01'])[0]}")
    return path / sequences[0]


READER = Reader("7scenes", "frame-NNNNNN.color.png, frame-NNNNNN.depth.png", recognises, open_seven_scenes)
