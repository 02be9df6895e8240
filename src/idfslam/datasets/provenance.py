"""Where the camera, the depth scale and the stamps of a recording come from, for the line about it at the start of a run."""

from dataclasses import dataclass

from idfslam.sensing.depth_deformation import DepthDeformation

STATED, ASSUMED, GENERATED = "stamps", "assumed", "generated"
"""Sources of stamps: the recording has some; it has none, and a rate is assumed. A generated recording knows all of its values."""


@dataclass(frozen=True)
class Provenance:
    """The sources of a recording's values: names of files, of flags, of publications."""

    camera: str
    depth_scale: float = 1.0  # units of the depth images per metre
    depth: str = ""  # empty: stated by the recording or the user; else where the default comes from
    stamps: str = STATED
    distortion: tuple[float, ...] = ()  # OpenCV's k1 k2 p1 p2 [k3 [k4 k5 k6]] that is removed from the images
    deformation: DepthDeformation | None = None  # of depth, that is taken out
    size: tuple[int, int] | None = None  # (width, height) [px] of the colour images as they are stored, if they were resized
    depth_delay: float = 0.0  # [s] by which depth is later than colour in the median, where that is worth telling; else 0
    notes: tuple[str, ...] = ()  # what was assumed about the images, for warnings


GUESSED = "a guess"
"""How the source of a camera begins of which nothing is known but its field of view."""


def is_guessed(dataset: object) -> bool:
    """Whether a dataset's camera is a guess."""
    found = provenance(dataset)
    return found is not None and found.camera.startswith(GUESSED)


def provenance(dataset: object) -> Provenance | None:
    """The provenance of a dataset's values: its attribute `provenance`; None where it has none, as in a live camera."""
    return getattr(dataset, "provenance", None)
