"""7-Scenes: seq-XX/frame-NNNNNN.{color.png,depth.png,pose.txt}; depth in millimetres, 65535 = no reading.

The published depth is not registered to colour; like other programs, this reader uses the depth camera's intrinsics for both.
"""

from pathlib import Path

from idfslam.datasets.cameras.calibration import Calibration, assumed_scale
from idfslam.datasets.cameras.camera_files import read_beside, read_depth_camera
from idfslam.datasets.images.decoding import ImageFiles, numbered
from idfslam.datasets.images.pairs import paired
from idfslam.datasets.near_miss import Likeness, part
from idfslam.datasets.provenance import ASSUMED
from idfslam.datasets.readers.folder import read_pose_files
from idfslam.datasets.recording import FPS, Reader, Recording
from idfslam.errors import RecordingError

PUBLISHED = Calibration(585.0, 585.0, 320.0, 240.0, 640, 480, source="the published camera of 7-Scenes")


def recognises(path: Path) -> bool:
    return any(path.glob("frame-*.color.png")) or any(path.glob("seq-*/frame-*.color.png"))


def open_seven_scenes(path: Path, stated: Calibration) -> Recording:
    """Opens the folder of a sequence, or of a scene with one sequence only."""
    path = _sequence(path)
    pairs = paired(numbered(path, "frame-*.color.png"), numbered(path, "frame-*.depth.png"), path)
    return Recording(
        f"{path.parent.name}-{path.name}",
        ImageFiles(pairs.files),
        timestamps=pairs.places / FPS,
        depth_timestamps=pairs.depth_timestamps(pairs.places / FPS),
        stamps_source=ASSUMED,
        ground_truth=lambda: read_pose_files(path, "frame-*.pose.txt", pairs),
        calibration=stated.over(read_beside(path, path.parent)).over(PUBLISHED).over(assumed_scale(1000, "7-Scenes layout")),
        depth_camera=read_depth_camera(path, path.parent),
    )


def _sequence(path: Path) -> Path:
    if any(path.glob("frame-*")):
        return path
    sequences = sorted({file.parent.name for file in path.glob("seq-*/frame-*")})
    if not sequences:
        raise RecordingError(f"{path}: no frame-NNNNNN.color.png, expected the folder seq-XX of a sequence")
    if len(sequences) > 1:
        raise RecordingError(f"{path}: {len(sequences)} sequences ({', '.join(sequences)}), expected one: name {path / sequences[0]}")
    return path / sequences[0]


READER = Reader(
    "7scenes",
    "frame-NNNNNN.color.png, frame-NNNNNN.depth.png",
    recognises,
    open_seven_scenes,
    likeness=Likeness("a sequence of 7-Scenes", (part("frame-*.color.png"), part("frame-*.depth.png"))),
)
