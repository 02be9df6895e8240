"""Reads frames ahead of their use in background threads: one, or several for a slow dataset (`reading_threads`)."""

from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor

from idfslam.datasets.recording import Dataset, reading_threads
from idfslam.errors import FrameError
from idfslam.frame import Frame


class Prefetch:
    """Iterates over (index, Frame), or (index, FrameError) for a bad frame, from `first` on, with up to `depth` frames read ahead.

    The threads end with the iteration, also after break, an error and Ctrl-C. Errors other than FrameError are raised to the caller.
    """

    def __init__(self, dataset: Dataset, *, depth: int = 4, first: int = 0) -> None:
        self._dataset, self._depth, self._first = dataset, depth, first

    def __len__(self) -> int:
        return len(self._dataset) - self._first

    def __iter__(self) -> Iterator[tuple[int, Frame | FrameError]]:
        pending: deque[Future[Frame | FrameError]] = deque()
        with ThreadPoolExecutor(reading_threads(self._dataset), thread_name_prefix="prefetch") as pool:
            try:
                end = len(self._dataset)
                for i in range(self._first, end):
                    while len(pending) <= self._depth and i + len(pending) < end:
                        pending.append(pool.submit(self._load, i + len(pending)))
                    yield i, pending.popleft().result()
            finally:
                for future in pending:
                    future.cancel()

    def _load(self, i: int) -> Frame | FrameError:
        try:
            return self._dataset[i]
        except FrameError as error:
            return error
