"""The read-out times of a sensor and the delay of its depth, as several recordings found them, in plain words.

SLAM estimates them while it runs (`alignment/timing_estimation.py`). They show where the camera moves fast.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from idfslam.adjustment.camera_findings import Finding
from idfslam.alignment.timing_estimation import SIGNIFICANT

_MEANINGS = {
    "readout": ("read-out of colour", "the rows of a colour image are exposed one after the other: motion bends it"),
    "depth_readout": ("read-out of depth", "the rows of a depth image are exposed one after the other: motion bends it"),
    "depth_delay": ("delay of depth", "depth is of another moment than its time stamp says: motion shifts it against colour"),
}


@dataclass(frozen=True)
class SensorTime:
    """A time of the sensor [s] with its standard deviation."""

    value: float
    sigma: float

    @property
    def is_sure(self) -> bool:
        """Whether it differs from zero, as it must to be used while frames are tracked."""
        return abs(self.value) > SIGNIFICANT * self.sigma


def mean_times(recordings: Sequence[Mapping[str, SensorTime]]) -> dict[str, SensorTime]:
    """The weighted mean of each time, by name, over the recordings that tell it."""
    found = dict[str, SensorTime]()
    for name in _MEANINGS:
        told = [times[name] for times in recordings if name in times]
        weight = sum(time.sigma**-2 for time in told)
        if told:
            found[name] = SensorTime(sum(time.value * time.sigma**-2 for time in told) / weight, weight**-0.5)
    return found


def time_findings(times: Mapping[str, SensorTime]) -> list[Finding]:
    """What was found of each time."""
    out = list[Finding]()
    for name, time in times.items():
        called, meaning = _MEANINGS[name]
        meaning = meaning if time.is_sure else "not told from zero: the camera moves too little, or all rows are of one moment"
        out.append(Finding(called, f"{1000 * time.value:.1f} ± {1000 * time.sigma:.1f} ms", meaning))
    return out
