"""The unit of depth images where nobody states one."""

from collections.abc import Sequence

from idfslam.datasets.cameras.calibration import Calibration, assumed_scale
from idfslam.datasets.images.decoding import FilePair, holds_floats


def usual_scale(pairs: Sequence[FilePair], units: float = 1000, why: str = "assumed") -> Calibration:
    """Floating-point numbers are metres; integers have the layout's `units` per metre, which `why` names. pairs: colour and depth."""
    first = next(((colour, depth) for colour, depth in pairs if depth is not None), None)
    return metres_if(first is not None and holds_floats(*first), units, why)


def metres_if(floats: bool, units: float = 1000, why: str = "assumed") -> Calibration:
    """The same, where it is known whether the images hold floating-point numbers."""
    return assumed_scale(1, "float images are metres") if floats else assumed_scale(units, why)
