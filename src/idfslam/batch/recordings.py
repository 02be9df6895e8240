"""Parses the recordings that the command line names. Each gets a unique name for its results."""

import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from idfslam.datasets import generated
from idfslam.datasets.recording_path import absolute
from idfslam.errors import ConfigError, RecordingError
from idfslam.storage.plain_values import one_line

_DIGITS = 9  # of a number of frames; raised, larger numbers pass. A hundred million frames are a month of a camera


@dataclass(frozen=True)
class RecordingSpec:
    """A recording, the name of its results, and how many of its frames are used."""

    name: str
    path: str
    frames: int | None = None  # None: all

    @property
    def gt_mesh(self) -> Path | None:
        """gt_mesh.ply in the recording's folder; None if there is none. A generated recording computes its own true surface."""
        place = Path(generated.kidnapped_path(self.path) or self.path)
        mesh = (place if place.is_dir() else place.parent) / "gt_mesh.ply"
        return mesh if place.exists() and mesh.is_file() else None


def parse_recordings(recordings: Sequence[str], frames: int | None = None, *, unique: bool = True) -> list[RecordingSpec]:
    """Parses paths and generated recordings, each with @FRAMES if wanted.

    frames: used where a recording has no @FRAMES; None: all. unique: recordings of the same name get their parent folder's name in front.
    Raises RecordingError for a missing recording, and ConfigError for an empty list or, with `unique`, for a repeated recording.
    """
    if not recordings:
        raise ConfigError(f"no recordings, expected at least one: paths, {generated.FORMS}, with @FRAMES if wanted")
    specs = [_parse(text, frames) for text in recordings]
    return _with_unique_names(specs) if unique else specs


def _with_unique_names(specs: Sequence[RecordingSpec]) -> list[RecordingSpec]:
    counts = Counter(spec.name for spec in specs)
    named = [replace(spec, name=f"{Path(spec.path).parent.name}-{spec.name}") if counts[spec.name] > 1 else spec for spec in specs]
    repeated = [name for name, count in Counter(spec.name for spec in named).items() if count > 1]
    if repeated:
        raise ConfigError(f"{', '.join(repeated)}: listed twice, expected recordings whose last two folders differ, each once")
    return named


def _parse(text: str, frames: int | None) -> RecordingSpec:
    path, mark, count = text.rpartition("@")
    if mark and count.isdecimal() and not os.path.exists(text):
        if len(count) > _DIGITS or int(count) < 1:
            raise ConfigError(f"{one_line(text)}: expected 1 frame or more after the @, in at most {_DIGITS} digits")
        frames = int(count)
    else:
        path = text
    inner = generated.kidnapped_path(path)
    if inner is not None:
        spec = _parse(inner, frames)
        return replace(spec, name=f"kidnap-{spec.name}", path=generated.KIDNAP + spec.path)
    if generated.kind_of(path) is not None:
        return RecordingSpec(path.replace(":", "-"), path, frames)
    if not os.path.exists(path):
        raise RecordingError(f"{one_line(path)}: no such file or folder, expected a recording, {generated.FORMS}, with @FRAMES if wanted")
    place = absolute(path)
    return RecordingSpec(place.stem if place.is_file() else place.name, str(place), frames)
