"""A plain folder whose colour is a video: rgb.mp4 (or color, colour, video; mp4, mov, mkv, avi ...) and depth/; the rest as in `folder`."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from idfslam.datasets import video
from idfslam.datasets.calibration import Calibration
from idfslam.datasets.image_folders import depth_folder
from idfslam.datasets.images import DEPTH_SUFFIXES, Depth, numbered, read_depth
from idfslam.datasets.readers.folder import calibrated, read_poses, usual_scale
from idfslam.datasets.recording import Reader, Recording
from idfslam.datasets.video import VideoTrack
from idfslam.errors import RecordingError

_NAMES = ("rgb", "color", "colour", "video")


def colour_video(path: Path) -> Path | None:
    """The colour video of a folder, if there is one; raises RecordingError if there are several."""
    if not path.is_dir():
        return None
    videos = sorted(file for file in path.iterdir() if file.stem.lower() in _NAMES and file.suffix.lower() in video.SUFFIXES)
    if len(videos) > 1:
        raise RecordingError(
            f"{path}: {len(videos)} colour videos ({', '.join(file.name for file in videos)}), expected one: remove the others"
        )
    return videos[0] if videos else None


def recognises(path: Path) -> bool:
    return depth_folder(path) is not None and colour_video(path) is not None


def open_video_folder(path: Path, override: Calibration) -> Recording:
    """Opens a folder. Video frame i belongs to the i-th depth image in the order of their numbers; stamps are the video's."""
    file, folder = colour_video(path), depth_folder(path)
    if file is None or folder is None:
        raise RecordingError(f"{path}: expected a video rgb.mp4 (or color, colour, video; mp4, mov, mkv, avi) and the folder depth/")
    track, depth = VideoTrack(file), numbered(folder, suffixes=DEPTH_SUFFIXES)
    if len(track) != len(depth):
        found = f"{len(track)} frames in {file.name} and {len(depth)} images in {folder.name}/"
        raise RecordingError(f"{path}: {found}, expected one depth image for each frame, in their order")
    files = list(depth.values())

    def read(i: int) -> tuple[NDArray[np.uint8], Depth]:
        return track.colour(i), read_depth(files[i])

    calibration, depth_camera = calibrated(path, override)
    return Recording(
        path.name,
        read,
        timestamps=track.times,
        ground_truth=read_poses(path, list(depth)),
        calibration=calibration.over(usual_scale([(file, depth) for depth in files])),
        depth_camera=depth_camera,
    )


READER = Reader("video", "rgb.mp4 or color.mkv, depth/, intrinsics.txt", recognises, open_video_folder)
