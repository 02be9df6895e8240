"""A plain folder whose colour is a video: rgb.mp4 (or color, colour, video; mp4, mov, mkv, avi ...) and depth/; the rest as in `folder`."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from idfslam.datasets.cameras.calibration import Calibration
from idfslam.datasets.cameras.camera_files import read_depth_camera
from idfslam.datasets.images import video
from idfslam.datasets.images.decoding import DEPTH_SUFFIXES, Depth, numbered, read_depth
from idfslam.datasets.images.depth_units import usual_scale
from idfslam.datasets.images.folders import depth_folder
from idfslam.datasets.images.pairs import Pairs, warn_left_out
from idfslam.datasets.images.partners import warn_without_own
from idfslam.datasets.images.video import VideoTrack
from idfslam.datasets.near_miss import Likeness
from idfslam.datasets.readers.folder import read_poses
from idfslam.datasets.recording import Reader, Recording
from idfslam.errors import RecordingError

_MISSING = 0.05  # [1] of the frames, at the end of video or depth images; raised, images of other frames are paired. Chosen by hand
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


def open_video_folder(path: Path, stated: Calibration) -> Recording:
    """Opens a folder. Video frame i belongs to the i-th depth image in the order of their numbers; stamps are the video's.

    A frame without a depth image has the nearest in time, if that is near.
    """
    file, folder = colour_video(path), depth_folder(path)
    if file is None or folder is None:
        raise RecordingError(f"{path}: expected a video rgb.mp4 (or color, colour, video; mp4, mov, mkv, avi) and the folder depth/")
    track = VideoTrack(file)
    pairs = paired_by_number(file, len(track), numbered(folder, suffixes=DEPTH_SUFFIXES))
    timestamps = track.times
    shown = pairs.with_nearest_depth(timestamps)

    def read(i: int) -> tuple[NDArray[np.uint8], Depth | None]:
        depth = shown.files[i][1]
        return track.colour(i), None if depth is None else read_depth(depth)

    return Recording(
        path.name,
        read,
        timestamps=timestamps,
        depth_timestamps=shown.depth_timestamps(timestamps),
        ground_truth=lambda: read_poses(path, pairs, timestamps),
        calibration=stated.over(usual_scale(pairs.files)),
        depth_camera=read_depth_camera(path),
        random_access=False,
    )


def paired_by_number(video: Path, frames: int, depth: dict[float, Path]) -> Pairs:
    """All frames of a video with depth images: in their order where there are equally many, else by the numbers of the depth images.

    Warns of frames without a depth image, and of depth images that are left out, because the video ends before them. Raises RecordingError
    if the numbers do not count the frames of the video.
    """
    numbers = np.array(list(depth))
    places = np.arange(frames) if len(depth) == frames else _counted(numbers, frames)
    found = f"{frames} frames in {video.name} and {len(depth)} images in depth/"
    if places is None or not len(places):
        raise RecordingError(f"{video.parent}: {found}, expected one depth image for each frame, in their order")
    within = places < frames
    images = dict(zip(places[within].tolist(), numbers[within].tolist()))  # frame -> number
    warn_left_out(str(video.parent), [f"{found} (they are paired by number)"] * int((~within).sum()))
    warn_without_own(str(video.parent), len(images), frames)
    step = (numbers[within][-1] - numbers[within][0]) / max(1, places[within][-1] - places[within][0])
    numbers_of_all = [float(images.get(i, numbers[within][0] + step * (i - places[within][0]))) for i in range(frames)]
    return Pairs(numbers_of_all, [(video, depth.get(number)) for number in numbers_of_all], np.arange(frames), frames)


def _counted(numbers: NDArray[np.float64], frames: int) -> NDArray[np.int64] | None:
    """The frames (N,) of a video that depth images with these numbers (N,) belong to; None if the numbers do not reach its end."""
    for step in (float(np.median(np.diff(numbers))), 1.0) if len(numbers) > 1 else ():
        first = 0.0 if numbers[-1] == step * (frames - 1) else numbers[0]
        places = (numbers - first) / step
        if np.all(places == np.round(places)) and abs(places[-1] - (frames - 1)) <= 1 + _MISSING * frames:
            return places.astype(np.int64)
    return None


READER = Reader(
    "video",
    "rgb.mp4 or color.mkv, depth/, intrinsics.txt",
    recognises,
    open_video_folder,
    likeness=Likeness("a folder with a video", ()),  # of a folder with one of the two, `folder` says what it lacks
)
