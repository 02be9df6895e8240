"""Recordings that have a name instead of files: generated rooms and corridors, and kidnappings of any recording."""

import re
from pathlib import Path

from idfslam.datasets.calibration import Calibration
from idfslam.datasets.recording import Dataset
from idfslam.errors import ConfigError, RecordingError

SYNTHETIC, CORRIDOR = "synthetic", "corridor"
NAMES = {SYNTHETIC: "synthetic[:SEED][:kinect]", CORRIDOR: "corridor[:SEED][:kinect][:Nlaps]"}
FORMS = f"{NAMES[SYNTHETIC]}, {NAMES[CORRIDOR]} or kidnap:RECORDING"
"""What to write, for messages and help."""
KIDNAP = "kidnap:"

_PATTERNS = {
    SYNTHETIC: re.compile(r"synthetic(?::(?P<seed>\d+))?(?P<noise>:kinect)?"),
    CORRIDOR: re.compile(r"corridor(?::(?P<seed>\d+))?(?P<noise>:kinect)?(?::(?P<laps>\d+)laps?)?"),
}


def kind_of(path: str) -> str | None:
    """SYNTHETIC or CORRIDOR where this is such a name and no file of that name lies there."""
    return next((kind for kind, pattern in _PATTERNS.items() if pattern.fullmatch(path) and not Path(path).exists()), None)


def kidnapped_path(path: str) -> str | None:
    """RECORDING of kidnap:RECORDING; None for any other path, and where a file has that very name."""
    return path[len(KIDNAP) :] if path.startswith(KIDNAP) and path != KIDNAP and not Path(path).exists() else None


def located(path: str) -> str:
    """The path of a recording as it is found from any folder: absolute, or a name, or kidnap: before one of these."""
    inner = kidnapped_path(path)
    if inner is not None:
        return KIDNAP + located(inner)
    return str(Path(path).absolute()) if Path(path).exists() else path


def open_generated(path: str, kind: str, given: Calibration, length: int) -> Dataset:
    """The recording of that name: one tour or the laps asked for, or `length` frames where that is more."""
    name = _PATTERNS[kind].fullmatch(path)
    if name is None:
        raise RecordingError(f"{path}: not a {kind} {'room' if kind == SYNTHETIC else 'recording'}, expected {NAMES[kind]}")
    if given != Calibration():
        what = f"a {kind} {'room' if kind == SYNTHETIC else 'recording'}"
        raise ConfigError(f"{path}: {what} has its own camera and depth, expected no override: leave the camera's values out")
    seed, noise = int(name["seed"] or 0), name["noise"] is not None
    if kind == SYNTHETIC:
        from idfslam.datasets.generated.room import TOUR, SyntheticRoom  # compiles its ray caster: only where it is asked for

        return SyntheticRoom(seed=seed, frames=max(TOUR, length), noise=noise)
    from idfslam.datasets.generated.corridor import SyntheticCorridor

    return SyntheticCorridor(seed=seed, laps=int(name["laps"] or 1), frames=length, noise=noise)
