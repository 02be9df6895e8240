"""What a run shows its frames to while it goes on: a viewer, or none."""

from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Protocol

import trimesh

from idfslam.frame import Frame, FrameResult
from idfslam.viewer.slam_view import SlamView


class Viewer(Protocol):
    """Shows a run frame by frame. It reads from Slam and changes nothing in it."""

    files: frozenset[str]  # names of the files that it writes to the result folder

    def opened(self, folder: Path, name: str) -> AbstractContextManager[None]:
        """A context in which the run of the recording `name` can be shown. Its files are complete afterwards, however the run ended."""

    def frame(self, frame: Frame, result: FrameResult, slam: SlamView) -> None:
        """Shows a frame that has just been processed."""

    def finish(self, slam: SlamView, mesh: trimesh.Trimesh) -> None:
        """Shows the final poses and the final mesh."""


class NullViewer:
    """A viewer that shows nothing."""

    files: frozenset[str] = frozenset()

    def opened(self, folder: Path, name: str) -> AbstractContextManager[None]:
        return nullcontext()

    def frame(self, frame: Frame, result: FrameResult, slam: SlamView) -> None: ...

    def finish(self, slam: SlamView, mesh: trimesh.Trimesh) -> None: ...


NO_VIEWER = NullViewer()
