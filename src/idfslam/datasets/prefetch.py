"""Frames decoded ahead of their use, in one background thread (decoding leaves the interpreter to others)."""

from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor

from idfslam.datasets.recording import Dataset
from idfslam.errors import FrameError
from idfslam.frame import Frame


class Prefetch:
    """Iterates over (index, Frame), or (index, FrameError) for a bad frame, with up to `depth` frames read ahead.

    The thread ends with the iteration: also on break, on an error and on Ctrl-C. Any other error of the dataset reaches the caller.
    """

    def __init__(self, dataset: Dataset, *, depth: int = 4) -> None:
        self._dataset, self._depth = dataset, depth

    def __len__(self) -> int:
        return len(self._dataset)

    def __iter__(self) -> Iterator[tuple[int, Frame | FrameError]]:
        pending: deque[Future[Frame | FrameError]] = deque()
        with ThreadPoolExecutor(1, thread_name_prefix="prefetch") as pool:
            try:
                for i in range(len(self)):
                    while len(pending) <= self._depth and i + len(pending) < len(self):
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
