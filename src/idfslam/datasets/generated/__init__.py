"""Recordings that are opened by a name instead of a path: generated rooms and corridors, and `kidnap:` before any recording."""

import re
from pathlib import Path

from idfslam.datasets.calibration import Calibration
from idfslam.datasets.recording import Dataset
from idfslam.datasets.recording_path import absolute
from idfslam.errors import ConfigError, RecordingError

SYNTHETIC, CORRIDOR = "synthetic", "corridor"
NAMES = {SYNTHETIC: "synthetic[:SEED][:kinect]", CORRIDOR: "corridor[:SEED][:kinect][:Nlaps]"}
FORMS = f"{NAMES[SYNTHETIC]}, {NAMES[CORRIDOR]} or kidnap:RECORDING"
"""The names, for messages and help."""
KIDNAP = "kidnap:"

_PATTERNS = {
    SYNTHETIC: re.compile(r"synthetic(?::(?P<seed>\d+))?(?P<noise>:kinect)?"),
    CORRIDOR: re.compile(r"corridor(?::(?P<seed>\d+))?(?P<noise>:kinect)?(?::(?P<laps>\d+)laps?)?"),
}


def kind_of(path: str) -> str | None:
    """SYNTHETIC or CORRIDOR if the path is such a name and no file has it; else None."""
    return next((kind for kind, pattern in _PATTERNS.items() if pattern.fullmatch(path) and not Path(path).exists()), None)


def kidnapped_path(path: str) -> str | None:
    """RECORDING of kidnap:RECORDING; None for any other path, and if a file has that name."""
    return path[len(KIDNAP) :] if path.startswith(KIDNAP) and path != KIDNAP and not Path(path).exists() else None


def absolute_path(path: str) -> str:
    """The path of a recording made absolute, so that it is valid in any folder; names of generated recordings stay as they are."""
    inner = kidnapped_path(path)
    if inner is not None:
        return KIDNAP + absolute_path(inner)
    return str(absolute(path)) if Path(path).expanduser().exists() else path


def open_generated(path: str, kind: str, calibration: Calibration, length: int) -> Dataset:
    """The generated recording of this name. It has one tour (room) or the named laps (corridor), or `length` frames if these are more."""
    name = _PATTERNS[kind].fullmatch(path)
    if name is None:
        raise RecordingError(f"{path}: not a {kind} {'room' if kind == SYNTHETIC else 'recording'}, expected {NAMES[kind]}")
    if calibration != Calibration():
        what = f"a {kind} {'room' if kind == SYNTHETIC else 'recording'}"
        raise ConfigError(f"{path}: {what} has its own camera and depth, expected no override: leave the camera's values out")
    seed, noise = int(name["seed"] or 0), name["noise"] is not None
    if kind == SYNTHETIC:
        from idfslam.datasets.generated.room import TOUR, SyntheticRoom  # imported here: it compiles a ray caster

        return SyntheticRoom(seed=seed, frames=max(TOUR, length), noise=noise)
    from idfslam.datasets.generated.corridor import SyntheticCorridor

    return SyntheticCorridor(seed=seed, laps=int(name["laps"] or 1), frames=length, noise=noise)
