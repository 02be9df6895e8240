"""Recordings that are opened by a name instead of a path: generated rooms and corridors, and `kidnap:` before any recording."""

import os
import re

from idfslam.datasets.cameras.calibration import Calibration
from idfslam.datasets.generated.faults import Faults
from idfslam.datasets.recording import Dataset
from idfslam.datasets.recording_path import absolute
from idfslam.errors import ConfigError, RecordingError
from idfslam.geometry.sensor_timing import UNKNOWN
from idfslam.storage.plain_values import one_line, shown

SYNTHETIC, CORRIDOR = "synthetic", "corridor"
SENSOR = ":kinect or :handheld[-FAULT[=STRENGTH][+...]]"
MOVING = ":people or :movers"
NAMES = {SYNTHETIC: f"synthetic[:SEED][{MOVING}][{SENSOR}]", CORRIDOR: f"corridor[:SEED][{MOVING}][{SENSOR}][:Nlaps]"}
FORMS = f"{NAMES[SYNTHETIC]}, {NAMES[CORRIDOR]} or kidnap:RECORDING"
"""The names, for messages and help."""
KIDNAP = "kidnap:"

_SENSOR = r"(?::(?P<movers>people|movers))?(?:(?P<noise>:kinect)|(?P<handheld>:handheld)(?:-(?P<faults>[^:]*))?)?"
_PATTERNS = {
    SYNTHETIC: re.compile(rf"synthetic(?::(?P<seed>\d{{1,9}}))?{_SENSOR}"),
    CORRIDOR: re.compile(rf"corridor(?::(?P<seed>\d{{1,9}}))?{_SENSOR}(?::(?P<laps>\d{{1,3}})laps?)?"),
}
_LONGEST = 1_000_000  # frames; raised, more memory is needed: 130 MB for the poses of a million. Chosen by hand: nine hours of a camera


def kind_of(path: str) -> str | None:
    """SYNTHETIC or CORRIDOR if the path is such a name and no file has it; else None."""
    return next((kind for kind, pattern in _PATTERNS.items() if pattern.fullmatch(path) and not os.path.exists(path)), None)


def kidnapped_path(path: str) -> str | None:
    """RECORDING of kidnap:RECORDING; None for any other path, and if a file has that name. Raises ConfigError if RECORDING is such too."""
    if not path.startswith(KIDNAP) or path == KIDNAP or os.path.exists(path):
        return None
    inner = path.removeprefix(KIDNAP)
    if inner.startswith(KIDNAP):
        raise ConfigError(f"{one_line(path)}: kidnapped more than once, expected {KIDNAP}RECORDING")
    return inner


def absolute_path(path: str) -> str:
    """The path of a recording made absolute, so that it is valid in any folder; names of generated recordings stay as they are."""
    inner = kidnapped_path(path)
    if inner is not None:
        return KIDNAP + absolute_path(inner)
    return str(absolute(path)) if os.path.exists(os.path.expanduser(path)) else path


def open_generated(path: str, kind: str, calibration: Calibration, length: int) -> Dataset:
    """The generated recording of this name. It has one tour (room) or the named laps (corridor), or `length` frames if these are more."""
    name = _PATTERNS[kind].fullmatch(path)
    if name is None:
        raise RecordingError(f"{one_line(path)}: not a {kind} {'room' if kind == SYNTHETIC else 'recording'}, expected {NAMES[kind]}")
    times = calibration.timing()
    if (calibration.with_times(UNKNOWN) if name["handheld"] else calibration) != Calibration():
        what = f"a {kind} {'room' if kind == SYNTHETIC else 'recording'}"
        raise ConfigError(f"{path}: {what} has its own camera and depth: leave the camera's values out")
    if length > _LONGEST:
        raise ConfigError(f"{path}: the last frame is number {shown(length)}, expected at most {_LONGEST}: choose --frames and --stride")
    seed, noise = int(name["seed"] or 0), name["noise"] is not None
    if name["handheld"]:
        from idfslam.datasets.generated import handheld

        faults = _faults(path, name["faults"])
        if kind == SYNTHETIC:
            return handheld.handheld_room(faults, seed, max(handheld.TOUR, length), known=times, movers=name["movers"])
        return handheld.handheld_corridor(faults, seed, int(name["laps"] or 1), length, known=times, movers=name["movers"])
    if kind == SYNTHETIC:
        from idfslam.datasets.generated.room import TOUR, SyntheticRoom  # imported here: it compiles a ray caster

        return SyntheticRoom(seed=seed, frames=max(TOUR, length), noise=noise, movers=name["movers"])
    from idfslam.datasets.generated.corridor import SyntheticCorridor

    return SyntheticCorridor(seed=seed, laps=int(name["laps"] or 1), frames=length, noise=noise, movers=name["movers"])


def _faults(path: str, text: str | None) -> Faults:
    try:
        return Faults.named(text)
    except ConfigError as error:
        raise ConfigError(f"{one_line(path)}: {error}") from error
