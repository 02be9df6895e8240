"""Frames made while something else is waited for."""

import threading
from types import TracebackType
from typing import TYPE_CHECKING

from idfslam.datasets.recording import Dataset, readers
from idfslam.errors import FrameError
from idfslam.frame import Frame

if TYPE_CHECKING:
    import trimesh


class Ahead:
    """A dataset whose first frames, up to `most` of them, a thread makes for as long as the context lasts.

    Each of them is kept until it is asked for. One that cannot be made ends it: whoever asks for that gets the error.
    """

    def __init__(self, dataset: Dataset, *, most: int) -> None:
        self._dataset, self._most = dataset, most
        self.name, self.camera, self.readers = dataset.name, dataset.camera, readers(dataset)
        self.timestamps, self.ground_truth = dataset.timestamps, dataset.ground_truth
        self._made: dict[int, Frame] = {}
        self._enough = threading.Event()
        self._thread = threading.Thread(target=self._make, name="ahead", daemon=True)

    def __enter__(self) -> "Ahead":
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._enough.set()
        self._thread.join()

    def __len__(self) -> int:
        return len(self._dataset)

    def __getitem__(self, i: int) -> Frame:
        return self._made.pop(i, None) or self._dataset[i]

    def surface(self) -> "trimesh.Trimesh | None":
        """The dataset's."""
        return self._dataset.surface()

    def _make(self) -> None:
        for i in range(min(self._most, len(self))):
            if self._enough.is_set():
                return
            try:
                self._made[i] = self._dataset[i]
            except FrameError:
                return
