"""The faults of a real sensor by name and strength: the end of names such as `synthetic:0:handheld-shutter=0.5+time`."""

import re
from dataclasses import dataclass, fields

from idfslam.errors import ConfigError
from idfslam.storage.plain_values import one_line

IDEAL = "ideal"
"""The name of no fault at all."""
STRONGEST = 10.0  # [1] largest strength; raised, read-out times are no sensor's. Chosen by hand

_ITEM = re.compile(r"(?P<fault>[^=]*)(?:=(?P<strength>\d{1,3}(?:\.\d{1,9})?))?")


@dataclass(frozen=True)
class Faults:
    """The strength of each fault: 0 without it, 1 as in a usual hand-held camera."""

    shutter: float = 0.0  # rolling shutters of both cameras
    time: float = 0.0  # depth is taken at other times than colour, and its stamps lie
    calibration: float = 0.0  # camera and depth are not as stated
    light: float = 0.0  # motion blur, automatic exposure and gain, vignetting, gamma
    depth: float = 0.0  # larger holes, and readings in mid-air at edges
    drops: float = 0.0  # frames are missing

    @staticmethod
    def named(text: str | None) -> "Faults":
        """The faults of such text as `shutter=0.5+time`; all of them for None, none for `ideal`. Raises ConfigError."""
        if text == IDEAL:
            return Faults()
        if text is None:
            return Faults(**dict.fromkeys(FAULTS, 1.0))
        strengths: dict[str, float] = {}
        for item in text.split("+"):
            found = _ITEM.fullmatch(item)
            fault = item if found is None else found["fault"]
            if found is None or fault not in FAULTS or fault in strengths:
                raise ConfigError(f"the fault is {one_line(item)!r}{' once more' * (fault in strengths)}, {_EXPECTED}")
            strengths[fault] = float(found["strength"] or 1)
            if strengths[fault] > STRONGEST:
                raise ConfigError(f"the strength of {fault} is {strengths[fault]:g}, expected 0 to {STRONGEST:g}")
        return Faults(**strengths)

    def __str__(self) -> str:
        """The text that `named` reads; `ideal` where no fault is left."""
        strengths = {fault: getattr(self, fault) for fault in FAULTS if getattr(self, fault) > 0}
        return "+".join(fault if strength == 1 else f"{fault}={strength:g}" for fault, strength in strengths.items()) or IDEAL


FAULTS = tuple(field.name for field in fields(Faults))
_EXPECTED = f"expected {IDEAL}, or {', '.join(FAULTS)}, joined with + and each with =STRENGTH where it is not 1"
