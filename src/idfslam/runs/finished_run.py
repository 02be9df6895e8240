"""Reads a result folder: trajectory, keyframes, map, and the recording that they came from."""

from dataclasses import replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from idfslam.datasets import Dataset
from idfslam.datasets.opening import is_there
from idfslam.errors import ConfigError, RecordingError, ResultError
from idfslam.evaluation.doubt import ReportedFrames
from idfslam.frame import Status
from idfslam.geometry.even_spacing import evenly_spread
from idfslam.geometry.trajectory import Trajectory, load_tum
from idfslam.mapping.saved_map import SavedMap, load_map
from idfslam.runs import result_folder
from idfslam.runs.frame_log import FrameLog
from idfslam.runs.keyframes_file import KeyframeRecord, read_keyframes
from idfslam.runs.lost_frames import of_all_frames
from idfslam.runs.metrics import corrected_frames, read_metrics
from idfslam.runs.run_config import RecordingSource, read_config
from idfslam.runs.source import open_source
from idfslam.views.image_archive import ImageArchive, load_archive
from idfslam.views.image_based_rendering import MapViews


class FinishedRun:
    """The results of a run. Each is read at its first use; a missing or damaged file raises a ResultError that names it."""

    def __init__(self, folder: Path, *, moved: Path | None = None) -> None:
        """moved: the recording's path, if it is no longer the one in config.yaml. Raises RecordingError if there is nothing."""
        self.folder, self._moved = folder, moved
        result_folder.existing(folder, result_folder.TRAJECTORY)
        if moved is not None and not is_there(str(moved)):
            raise RecordingError(f"{moved}: no such file or folder, expected the run's recording: correct --recording, or leave it out")

    @cached_property
    def trajectory(self) -> Trajectory:
        """The poses of all frames. Those that `run --lost drop` left out of trajectory.txt have the pose of the last measured one."""
        return self._frames_and_listed[0]

    @property
    def listed(self) -> NDArray[np.int64]:
        """The indices (M,) of the frames that trajectory.txt holds."""
        return self._frames_and_listed[1]

    @cached_property
    def _frames_and_listed(self) -> tuple[Trajectory, NDArray[np.int64]]:
        return of_all_frames(load_tum(result_folder.existing(self.folder, result_folder.TRAJECTORY)), self.frames)

    @cached_property
    def keyframes(self) -> KeyframeRecord:
        """The keyframes and the camera."""
        return read_keyframes(self.folder)

    @cached_property
    def map(self) -> SavedMap:
        """The neural map."""
        return load_map(result_folder.existing(self.folder, result_folder.MAP))

    @cached_property
    def archive(self) -> ImageArchive | None:
        """The images that views of the map are made of; None if the run kept none."""
        path = self.folder / result_folder.ARCHIVE
        return load_archive(path) if path.is_file() else None

    @cached_property
    def views(self) -> MapViews | SavedMap:
        """What renders views: the map with the images of the run, or the map alone where the run kept none."""
        return self.map if self.archive is None else MapViews(self.map, self.archive)

    @cached_property
    def frames(self) -> FrameLog | None:
        """Statuses, times and losses of the frames; None if the folder has no frames.csv (older versions)."""
        path = self.folder / result_folder.FRAMES
        return FrameLog.load(path) if path.is_file() else None

    @cached_property
    def recording(self) -> Dataset:
        """The recording of the run. Raises RecordingError if it cannot be found, ResultError if config.yaml names none or it is another."""
        _, source = read_config(self.folder)
        if source is None and self._moved is None:
            raise ResultError(f"{self.folder}: {result_folder.CONFIG} names no recording; give it with --recording")
        named = source or RecordingSource("")
        recording = open_source(named if self._moved is None else replace(named, path=str(self._moved)))
        if len(recording) < len(self.trajectory) or recording.camera != self.keyframes.camera:
            size = f"{len(recording)} frames of {recording.camera.width}x{recording.camera.height}"
            own = f"{len(self.trajectory)} of {self.keyframes.camera.width}x{self.keyframes.camera.height}"
            raise ResultError(f"{self.folder}: its recording has {size}, the run {own} or another camera; give its own with --recording")
        return recording

    @cached_property
    def statuses(self) -> list[Status]:
        """How the pose of each frame of the trajectory was found; `ok` for all if the folder has no frames.csv."""
        statuses = [Status.OK] * len(self.trajectory)
        for line in self.frames.lines if self.frames else ():
            if line.index < len(statuses):
                statuses[line.index] = line.status
        return statuses

    @cached_property
    def reported(self) -> ReportedFrames | None:
        """What was reported of each frame at the time, without covariances; None if the folder lacks it (older versions, failed runs)."""
        path, metrics = self.folder / result_folder.LIVE, self.folder / result_folder.METRICS
        if self.frames is None or not path.is_file():
            return None
        corrected = corrected_frames(read_metrics(self.folder)) if metrics.is_file() else ()
        return self.frames.reported(load_tum(path), corrected)

    @property
    def measured(self) -> NDArray[np.bool_]:
        """(N,) whether the pose of a frame was measured: it is neither extrapolated nor interpolated."""
        return np.array([status.measured for status in self.statuses], bool)

    @property
    def trusted(self) -> NDArray[np.bool_]:
        """(N,) whether the pose of a frame was measured and is not in doubt."""
        return np.array([status.trusted for status in self.statuses], bool)

    def frames_to_show(self, count: int | None, *, guessed: bool = False) -> NDArray[np.int64]:
        """The indices of `count` frames evenly spread over the run, or of all if there are fewer. None: those of the keyframes.

        guessed: frames whose pose was not measured or is in doubt are among them. Raises ConfigError for a count below 1, ResultError if
        there is none.
        """
        wanted = np.full(len(self.trajectory), True) if guessed else self.trusted
        if count is None:
            chosen = np.array([i for i in self.keyframes.indices if i < len(wanted) and wanted[i]], np.int64)
        elif count < 1:
            raise ConfigError(f"--images {count}, expected at least 1")
        else:
            found = np.flatnonzero(wanted)
            chosen = found[evenly_spread(len(found), count)]
        if not len(chosen):
            raise ResultError(
                f"{self.folder}: the run has no {'keyframe' if count is None else 'frame'} whose pose was measured and is not in doubt"
            )
        return chosen
