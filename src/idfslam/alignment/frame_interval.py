"""The usual interval of a recording's frames. Stamps jitter with their transport, exposures do not, so times count in whole frames."""

from collections import deque
from collections.abc import Sequence
from statistics import median

from idfslam.frame import FPS

# [frames] whose stamps give the usual interval, by their median. More: changes of the rate are followed more slowly. Chosen by hand.
_FRAMES = 31


class FrameInterval:
    """The median of the last intervals."""

    def __init__(self, recent: Sequence[float] = ()) -> None:
        self._recent = deque(recent, maxlen=_FRAMES)

    def recent(self) -> list[float]:
        """The last intervals [s], of which it can be made again."""
        return list(self._recent)

    def add(self, interval: float) -> None:
        """Learns the time [s] between two frames in a row. Stamps that do not grow tell nothing."""
        if interval > 0:
            self._recent.append(interval)

    def in_whole_frames(self, elapsed: float) -> float:
        """A time between two frames [s] as a multiple of the usual interval, one at least."""
        usual = median(self._recent) if self._recent else 1 / FPS
        return max(round(elapsed / usual), 1) * usual
