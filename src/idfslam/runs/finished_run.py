"""Reads a result folder: trajectory, keyframes, map, and the recording that they came from."""

from dataclasses import replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from idfslam.datasets import Dataset
from idfslam.errors import ConfigError, ResultError
from idfslam.frame import Status
from idfslam.geometry.trajectory import Trajectory, load_tum
from idfslam.mapping.saved_map import SavedMap, load_map
from idfslam.runs import result_folder
from idfslam.runs.frame_log import FrameLog
from idfslam.runs.source import open_source


class FinishedRun:
    """The results of a run. Each is read at its first use; a missing or damaged file raises a ResultError that names it."""

    def __init__(self, folder: Path, *, moved: Path | None = None) -> None:
        """moved: the recording's path, if it is no longer the one in config.yaml."""
        self.folder, self._moved = folder, moved
        result_folder.existing(folder, result_folder.TRAJECTORY)

    @cached_property
    def trajectory(self) -> Trajectory:
        """The poses of all frames."""
        return load_tum(result_folder.existing(self.folder, result_folder.TRAJECTORY))

    @cached_property
    def keyframes(self) -> result_folder.KeyframeRecord:
        """The keyframes and the camera."""
        return result_folder.read_keyframes(self.folder)

    @cached_property
    def map(self) -> SavedMap:
        """The neural map."""
        return load_map(result_folder.existing(self.folder, result_folder.MAP))

    @cached_property
    def frames(self) -> FrameLog | None:
        """Statuses, times and losses of the frames; None if the folder has no frames.csv (older versions)."""
        path = self.folder / result_folder.FRAMES
        return FrameLog.load(path) if path.is_file() else None

    @cached_property
    def recording(self) -> Dataset:
        """The recording of the run. Raises RecordingError if it cannot be found, ResultError if config.yaml names none or it is another."""
        _, source = result_folder.read_config(self.folder)
        if source is None and self._moved is None:
            raise ResultError(f"{self.folder}: {result_folder.CONFIG} names no recording; give it with --recording")
        named = source or result_folder.Source("")
        recording = open_source(named if self._moved is None else replace(named, path=str(self._moved)))
        if len(recording) < len(self.trajectory) or recording.camera != self.keyframes.camera:
            size = f"{len(recording)} frames of {recording.camera.width}x{recording.camera.height}"
            own = f"{len(self.trajectory)} of {self.keyframes.camera.width}x{self.keyframes.camera.height}"
            raise ResultError(f"{self.folder}: its recording has {size}, the run {own} or another camera; give its own with --recording")
        return recording

    def frames_to_show(self, count: int | None) -> NDArray[np.int64]:
        """`count` frames evenly spread over the frames with a measured pose, or all of these if there are fewer. None: the keyframes.

        Raises ConfigError for a count below 1, ResultError if there is no such frame.
        """
        if count is None:
            chosen = self.keyframes.indices
        elif count < 1:
            raise ConfigError(f"--images {count}, expected at least 1")
        else:
            lines = self.frames.lines if self.frames else ()
            guessed = [line.index for line in lines if line.status in (Status.LOST, Status.INTERPOLATED)]
            measured = np.setdiff1d(np.arange(len(self.trajectory)), guessed)
            places = np.linspace(0, len(measured) - 1, count).round().astype(int)
            chosen = measured[np.unique(places)] if len(measured) else measured
        if not len(chosen):
            raise ResultError(f"{self.folder}: the run has no {'keyframes' if count is None else 'frame whose pose was measured'}")
        return chosen
