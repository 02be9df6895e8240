"""The camera of a recording: values from the user, from files and from publications, and their order of precedence."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from idfslam.datasets.cameras.plausibility import flags, in_fractions, meant_for
from idfslam.datasets.provenance import GUESSED
from idfslam.errors import ConfigError, RecordingError
from idfslam.geometry.camera import Camera
from idfslam.geometry.sensor_timing import SensorTiming
from idfslam.sensing.depth_deformation import DepthDeformation

TIMES = ("readout", "depth_readout", "depth_delay")
"""The names of a sensor's times, in Calibration, SensorTiming, files and flags."""
GIVE_CAMERA = "give cam_params.json in the recording or --camera.fx --camera.fy --camera.cx --camera.cy"
# [degrees] across the colour image, of a sensor about which nothing is known: Kinect 63, RealSense D435 69, Structure 59, iPad 66.
# Calibration finds focal lengths that are up to about 10 % off. More: wider cameras are found, and narrower ones are not.
USUAL_FIELD_OF_VIEW = 65.0
_NARROWEST = 1.0  # [degrees] least view across an image's width; raised, long lenses are refused. Depth cameras have 40 and more
_FIELDS_OF_VIEW = 10.0, 140.0  # [degrees] of pinhole cameras; wider: more slips of the keyboard pass. Chosen by hand


@dataclass(frozen=True)
class Calibration:
    """Values of a camera from one source (the user, a file, a publication); None where the source gives no value."""

    fx: float | None = None  # [px], like fy, cx, cy
    fy: float | None = None
    cx: float | None = None
    cy: float | None = None
    width: int | None = None  # [px] of the images that it is valid for
    height: int | None = None
    distortion: tuple[float, ...] | None = None  # OpenCV's k1 k2 p1 p2 [k3 [k4 k5 k6]]
    depth_scale: float | None = None  # units of the depth images per metre
    deformation: DepthDeformation | None = None  # of depth, which is taken out
    reach: float | None = None  # [m] depth from here on is no reading; None: all depth counts
    readout: float | None = None  # [s] see `SensorTiming`
    depth_readout: float | None = None  # [s]
    depth_delay: float | None = None  # [s]
    field_of_view: float | None = None  # [degrees] across the image; used where none of fx, fy, cx and cy is known
    source: str = "the command line"
    assumed: str = ""  # where a depth scale comes from that nobody stated, for example "TUM layout"

    @property
    def complete(self) -> bool:
        """Whether focal lengths and principal point are all given."""
        return None not in (self.fx, self.fy, self.cx, self.cy)

    def over(self, other: "Calibration") -> "Calibration":
        """These values, with missing ones taken from `other`, a source of lower precedence.

        If fx, fy, cx and cy are all given, only depth scale, reach and times are taken from `other`: without distortion values there is no
        distortion.
        """
        scale, assumed = (other.depth_scale, other.assumed) if self.depth_scale is None else (self.depth_scale, self.assumed)
        if self.complete:
            times = SensorTiming(*(getattr(other if getattr(self, name) is None else self, name) for name in TIMES))
            reach = other.reach if self.reach is None else self.reach
            return replace(self, depth_scale=scale, assumed=assumed, reach=reach).with_times(times)
        stated = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in ("source", "assumed")}
        stated = {name: value for name, value in stated.items() if value is not None}
        if partly := [name for name in ("fx", "fy", "cx", "cy") if name in stated]:
            stated["source"] = f"{other.source} with {', '.join(partly)} of {self.source}" if other.complete else self.source
        return replace(other, **(stated | {"depth_scale": scale, "assumed": assumed}))

    def resized(self, size: tuple[int, int], to: tuple[int, int]) -> "Calibration":
        """The calibration after images of one size (width, height) [px] were scaled to another; unchanged if it is not complete."""
        if self.fx is None or self.fy is None or self.cx is None or self.cy is None:
            return self
        camera = Camera(*size, self.fx, self.fy, self.cx, self.cy).resized(*to)
        return replace(self, fx=camera.fx, fy=camera.fy, cx=camera.cx, cy=camera.cy, width=to[0], height=to[1])

    def guessed(self, width: int, height: int) -> "Calibration":
        """With a camera guessed from the field of view, of images `width` x `height` [px], if there is one and no camera is known."""
        if self.field_of_view is None or not all(value is None for value in (self.fx, self.fy, self.cx, self.cy)):
            return self
        focal = width / 2 / math.tan(math.radians(self.field_of_view) / 2)
        source = f"{GUESSED}: {self.field_of_view:g} degrees across"
        return replace(self, fx=focal, fy=focal, cx=(width - 1) / 2, cy=(height - 1) / 2, width=width, height=height, source=source)

    def camera(self, width: int, height: int, recording: str) -> Camera:
        """The camera of images `width` x `height` [px].

        Raises RecordingError if the camera is unknown, valid for another image size only, or impossible.
        """
        if self.fx is None or self.fy is None or self.cx is None or self.cy is None:
            missing = ", ".join(name for name in ("fx", "fy", "cx", "cy") if getattr(self, name) is None)
            guess = "start from --camera.guess" if self.field_of_view is None else "give none of them, so that the camera is guessed"
            raise RecordingError(f"{recording}: the camera is unknown ({missing} missing): {GIVE_CAMERA}, or {guess}")
        found = f"fx {self.fx:g}, fy {self.fy:g}, cx {self.cx:g}, cy {self.cy:g}"
        if not all(map(math.isfinite, (self.fx, self.fy, self.cx, self.cy))) or min(self.fx, self.fy) <= 0:
            raise RecordingError(f"{recording}: {self.source} says {found}: expected finite numbers with fx and fy above 0 (y points down)")
        if math.degrees(2 * math.atan(width / 2 / max(self.fx, self.fy))) < _NARROWEST:
            raise RecordingError(f"{recording}: {self.source} says {found}: a view of no degree, expected focal lengths in pixels")
        if not all(map(math.isfinite, self.distortion or ())):
            found = " ".join(f"{value:g}" for value in self.distortion or ())
            raise RecordingError(f"{recording}: {self.source} says distortion {found}: expected finite numbers")
        camera, size = Camera(width, height, self.fx, self.fy, self.cx, self.cy), (self.width or width, self.height or height)
        if size != (width, height):
            found = f"images are {width}x{height}, but {self.source} is for {size[0]}x{size[1]}"
            same_shape = min(size) > 0 and abs(size[0] * height - size[1] * width) <= max(width, height)
            resized = f" (if they were only resized: {flags(replace(camera, width=size[0], height=size[1]).resized(width, height))})"
            raise RecordingError(f"{recording}: {found}: {GIVE_CAMERA} of these images{resized if same_shape else ''}")
        if (pixels := in_fractions(camera)) is not None:
            found += " in fractions of the image"
            raise RecordingError(f"{recording}: {self.source} says {found}, expected pixels: give {flags(pixels)}")
        if not (0 <= self.cx < width and 0 <= self.cy < height):
            found = f"the principal point ({self.cx:g}, {self.cy:g}) of {self.source} lies outside the {width}x{height} images"
            raise RecordingError(f"{recording}: {found}: {meant_for(camera) or f'{GIVE_CAMERA} in pixels of these images'}")
        return camera

    def with_times(self, times: SensorTiming) -> "Calibration":
        """The same, with these times of the sensor."""
        return replace(self, readout=times.readout, depth_readout=times.depth_readout, depth_delay=times.depth_delay)

    def timing(self) -> SensorTiming:
        """The times of the sensor; None for those that nobody states. Raises ConfigError for values that are no sensor's."""
        return SensorTiming(self.readout, self.depth_readout, self.depth_delay)

    def scale(self, recording: str) -> float:
        """Units of the depth images per metre; raises RecordingError if unknown or not positive."""
        if self.depth_scale is None or not (math.isfinite(self.depth_scale) and self.depth_scale > 0):
            found = f"the depth scale is {self.depth_scale}"
            raise RecordingError(f"{recording}: {found}, expected units per metre above 0: give --camera.depth-scale")
        return self.depth_scale


def assumed_scale(depth_scale: float, why: str = "assumed") -> Calibration:
    """The depth scale [units per metre] of a layout, for recordings that state none; `why` says so in the line about the recording."""
    return Calibration(depth_scale=depth_scale, assumed=why)


def given_values(camera: Mapping[str, float | None] | None, depth_scale: float | None = None) -> Calibration:
    """The user's values: any of fx, fy, cx, cy, field_of_view, depth_scale, reach and TIMES; None counts as not given.

    Raises ConfigError for other keys, for a field of view that is no pinhole camera's, for a reach of no distance, and for times that are
    no sensor's.
    """
    values = {key: value for key, value in (camera or {}).items() if value is not None}
    allowed = ("fx", "fy", "cx", "cy", "field_of_view", "depth_scale", "reach", *TIMES)
    if unknown := [key for key in values if key not in allowed]:
        raise ConfigError(f"camera: unknown value '{unknown[0]}', expected any of {', '.join(allowed)}")
    if not _FIELDS_OF_VIEW[0] <= (width := values.get("field_of_view", USUAL_FIELD_OF_VIEW)) <= _FIELDS_OF_VIEW[1]:
        raise ConfigError("camera: field of view {:g}, expected {:g} to {:g} degrees".format(width, *_FIELDS_OF_VIEW))
    if not (reach := values.get("reach", math.inf)) > 0:
        raise ConfigError(f"camera: a reach of {reach:g} m, expected metres above 0, from which on depth counts as no reading")
    scale = values.get("depth_scale") if depth_scale is None else depth_scale
    times = SensorTiming(*(values.get(name) for name in TIMES))
    pinhole = Calibration(values.get("fx"), values.get("fy"), values.get("cx"), values.get("cy"), depth_scale=scale)
    return replace(pinhole, field_of_view=values.get("field_of_view"), reach=values.get("reach")).with_times(times)


@dataclass(frozen=True)
class DepthCameraCalibration:
    """The calibration of a depth camera whose images are not registered to the colour camera."""

    calibration: Calibration
    T_colour_depth: NDArray[np.float64]  # (4, 4) [m] depth camera to colour camera
