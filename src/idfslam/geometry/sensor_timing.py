"""When the rows of a colour and of a depth image were exposed: read-out times of rolling shutters, and a delay between the two cameras."""

import math
from dataclasses import dataclass, fields

from idfslam.errors import ConfigError

LONGEST = 0.5  # [s] largest read-out time and delay that is a sensor's: half a second is 15 frames. More: milliseconds pass for seconds


@dataclass(frozen=True)
class SensorTiming:
    """Times of a sensor [s]. All are zero for a global shutter with colour and depth of one moment. None: unknown.

    Row r of an image of H rows is exposed `readout * ((r + 0.5) / H - 0.5)` after the image's time stamp, which is that of its middle row.
    Depth is taken `depth_delay` later than its time stamp says. Raises ConfigError for a value that is not a finite number of seconds, for
    a negative read-out time, and above half a second.
    """

    readout: float | None = 0.0  # of the colour image, from its first row to its last
    depth_readout: float | None = 0.0  # of the depth image
    depth_delay: float | None = 0.0

    def __post_init__(self) -> None:
        for field in fields(self):
            value, least = getattr(self, field.name), -LONGEST if field.name == "depth_delay" else 0.0
            if value is not None and not (isinstance(value, int | float) and math.isfinite(value) and least <= value <= LONGEST):
                raise ConfigError(f"{field.name} is {value!r}, expected seconds from {least:g} to {LONGEST:g}")


SYNCHRONISED = SensorTiming()
"""A global shutter, with colour and depth of one moment."""

UNKNOWN = SensorTiming(None, None, None)
"""A sensor of which nobody states any of these times."""
