"""A result folder opened again: trajectory, keyframes, map, and the recording that they were made of."""

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
    """Each part is read when it is asked for; what is missing or damaged is a ResultError that names the file."""

    def __init__(self, folder: Path, *, moved: Path | None = None) -> None:
        """moved: where the recording lies now, if not where config.yaml says."""
        self.folder, self._moved = folder, moved
        result_folder.existing(folder, result_folder.TRAJECTORY)

    @cached_property
    def trajectory(self) -> Trajectory:
        """Of all frames."""
        return load_tum(result_folder.existing(self.folder, result_folder.TRAJECTORY))

    @cached_property
    def keyframes(self) -> result_folder.KeyframeRecord:
        """And the camera."""
        return result_folder.read_keyframes(self.folder)

    @cached_property
    def map(self) -> SavedMap:
        """The neural map."""
        return load_map(result_folder.existing(self.folder, result_folder.MAP))

    @cached_property
    def frames(self) -> FrameLog | None:
        """Statuses, times and losses; None where the folder has none, as of older versions."""
        path = self.folder / result_folder.FRAMES
        return FrameLog.load(path) if path.is_file() else None

    @cached_property
    def recording(self) -> Dataset:
        """The frames that the run was made of. Raises RecordingError where it is not to be found, ResultError where none is named."""
        _, source = result_folder.read_config(self.folder)
        if source is None and self._moved is None:
            raise ResultError(f"{self.folder}: {result_folder.CONFIG} names no recording; say where its images are with --recording")
        found = source or result_folder.Source("")
        recording = open_source(found if self._moved is None else replace(found, path=str(self._moved)))
        if len(recording) < len(self.trajectory) or recording.camera != self.keyframes.camera:
            size = f"{len(recording)} frames of {recording.camera.width}x{recording.camera.height}"
            own = f"{len(self.trajectory)} of {self.keyframes.camera.width}x{self.keyframes.camera.height}"
            raise ResultError(f"{self.folder}: its recording has {size}, the run {own} or another camera; give its own with --recording")
        return recording

    def spread(self, count: int | None) -> NDArray[np.int64]:
        """`count` frames (fewer, where the run has fewer) evenly spread over those whose pose was measured; None: the keyframes.

        Raises ConfigError for a count below 1, ResultError where there is no such frame.
        """
        if count is None:
            found = self.keyframes.indices
        elif count < 1:
            raise ConfigError(f"--images {count}, expected at least 1")
        else:
            lines = self.frames.lines if self.frames else ()
            guessed = [line.index for line in lines if line.status in (Status.LOST, Status.INTERPOLATED)]
            known = np.setdiff1d(np.arange(len(self.trajectory)), guessed)
            found = known[np.unique(np.linspace(0, len(known) - 1, count).round().astype(int))] if len(known) else known
        if not len(found):
            raise ResultError(f"{self.folder}: the run has no {'keyframes' if count is None else 'frame whose pose was measured'}")
        return found
