"""Whether a pinhole camera can be that of its images, and which mistake explains one that cannot."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

from idfslam.geometry.camera import Camera

FIELD_OF_VIEW = (20.0, 120.0)  # [degrees] of depth cameras across the image's width; widened, fewer wrong focal lengths are found. Depth
#    cameras on the market have 42 (Gemini) to 120 (Azure Kinect, wide)
MAX_OFFSET = 0.1  # [1] of width and height, of the principal point from the middle; raised, more cameras of other sizes pass. Lenses are
#    centred to a few per cent; a camera of half the size is off by a quarter
MAX_ANISOTROPY = 0.1  # [1] difference of fx and fy; raised, more exchanged values pass. Pixels are square to a per cent. Chosen by hand
FRACTIONAL = 4.0  # largest focal length that is in image sizes rather than in pixels; raised, images of very few pixels are refused
LENS = (0.3, 3.0)  # [1] factors by which distortion may move the image's corner; widened, more nonsense passes. Chosen by hand
_SIZES = (2.0, 0.5, 3.0, 1 / 3, 4.0, 0.25, 1.5, 2 / 3)  # [1] of our images over those that a camera may be meant for, the commonest first;
#    more: more is proposed, wrongly too. By hand


def flags(camera: Camera) -> str:
    """The command-line flags that state this camera."""
    return f"--camera.fx {camera.fx:.1f} --camera.fy {camera.fy:.1f} --camera.cx {camera.cx:.1f} --camera.cy {camera.cy:.1f}"


def of_another_size(camera: Camera) -> Camera | None:
    """The size of the images that a camera with a principal point far from the middle is probably meant for; None if no usual size fits."""
    for factor in _SIZES:
        meant = replace(camera, width=round(camera.width / factor), height=round(camera.height / factor))
        if max(_offset(meant)) < MAX_OFFSET / 2:
            return meant
    return None


def in_fractions(camera: Camera) -> Camera | None:
    """The camera in pixels if its values are fractions of the image's width and height; else None."""
    if max(camera.fx, camera.fy) > FRACTIONAL or not (0 < camera.cx < 1 and 0 < camera.cy < 1):
        return None
    w, h = camera.width, camera.height
    return Camera(w, h, camera.fx * w, camera.fy * h, camera.cx * w - 0.5, camera.cy * h - 0.5)


def doubts(camera: Camera, source: str) -> Iterator[str]:
    """What is implausible about a camera: one line each with the likely cause and the flags that mend it. `source` says who stated it."""
    if max(_offset(camera)) > MAX_OFFSET:
        found = f"the principal point ({camera.cx:.1f}, {camera.cy:.1f}) of {source} is far from the middle of the image"
        yield f"{found}: {meant_for(camera) or 'give --camera.cx and --camera.cy of these images'}"
    elif not FIELD_OF_VIEW[0] <= (angle := math.degrees(2 * math.atan(camera.width / 2 / camera.fx))) <= FIELD_OF_VIEW[1]:
        usual = f"expected {FIELD_OF_VIEW[0]:.0f} to {FIELD_OF_VIEW[1]:.0f}"
        yield f"the focal length {camera.fx:.1f} px of {source} means a view of {angle:.0f} degrees, {usual}: give --camera.fx, --camera.fy"
    if abs(camera.fx / camera.fy - 1) > MAX_ANISOTROPY:
        found = f"fx {camera.fx:.1f} and fy {camera.fy:.1f} of {source} differ by {100 * abs(camera.fx / camera.fy - 1):.0f} %"
        yield f"{found}, expected square pixels unless the images were stretched: give --camera.fx, --camera.fy"


def lens_doubt(camera: Camera, distortion: Sequence[float], source: str) -> str | None:
    """What is implausible about distortion values k1 k2 p1 p2 [k3 [k4 k5 k6]]; None if they can be a lens."""
    k1, k2, _, _, k3, k4, k5, k6 = [*distortion, *([0.0] * (8 - len(distortion)))]
    x = max(camera.cx, camera.width - 1 - camera.cx) / camera.fx
    y = max(camera.cy, camera.height - 1 - camera.cy) / camera.fy
    for edge in (x * x, y * y):  # the corner itself often lies outside of what was calibrated
        factor = (1 + edge * (k1 + edge * (k2 + edge * k3))) / ((1 + edge * (k4 + edge * (k5 + edge * k6))) or math.nan)
        if not LENS[0] <= factor <= LENS[1]:
            values = " ".join(f"{value:g}" for value in distortion)
            found = f"the distortion {values} of {source} moves the edge of the image by a factor {factor:.1f}"
            return f"{found}, expected OpenCV's k1 k2 p1 p2 [k3 [k4 k5 k6]]: correct it, or give {flags(camera)} for none"
    return None


def meant_for(camera: Camera) -> str:
    """The likely cause of a principal point far from the middle, and the flags; empty if no usual size of images explains it."""
    if (meant := of_another_size(camera)) is None:
        return ""
    return f"the camera is probably of {meant.width}x{meant.height} images; then give {flags(meant.resized(camera.width, camera.height))}"


def _offset(camera: Camera) -> tuple[float, float]:
    """The distance of the principal point from the middle, as shares of width and height."""
    return abs(camera.cx - (camera.width - 1) / 2) / camera.width, abs(camera.cy - (camera.height - 1) / 2) / camera.height
