"""Frames rendered in the background while the program does something else."""

import threading
from types import TracebackType
from typing import TYPE_CHECKING

from idfslam.datasets.provenance import provenance
from idfslam.datasets.recording import Dataset, depth_timestamps, reading_threads, timing
from idfslam.errors import FrameError
from idfslam.frame import Frame

if TYPE_CHECKING:
    import trimesh


class Prerendered:
    """A dataset whose first frames, at most `most`, are rendered by a thread for as long as the context lasts.

    A rendered frame is kept until it is read once. The thread ends at a frame that cannot be rendered; reading this frame raises the error.
    `Prefetch` reads ahead of one iteration; this renders before the iteration begins.
    """

    def __init__(self, dataset: Dataset, *, most: int) -> None:
        self._dataset, self._most = dataset, most
        self.name, self.camera, self.reading_threads = dataset.name, dataset.camera, reading_threads(dataset)
        self.provenance = provenance(dataset)
        self.timestamps, self.ground_truth = dataset.timestamps, dataset.ground_truth
        self.depth_timestamps, self.timing = depth_timestamps(dataset), timing(dataset)
        self._frames: dict[int, Frame] = {}
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._render, name="prerender", daemon=True)

    def __enter__(self) -> "Prerendered":
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._stop.set()
        self._thread.join()

    def __len__(self) -> int:
        return len(self._dataset)

    def __getitem__(self, i: int) -> Frame:
        return self._frames.pop(i, None) or self._dataset[i]

    def surface(self) -> "trimesh.Trimesh | None":
        """The dataset's true surface, if known."""
        return self._dataset.surface()

    def _render(self) -> None:
        for i in range(min(self._most, len(self))):
            if self._stop.is_set():
                return
            try:
                self._frames[i] = self._dataset[i]
            except FrameError:
                return
