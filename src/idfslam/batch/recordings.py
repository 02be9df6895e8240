"""Recordings named on the command line, each with a name of its own for its results."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from idfslam.datasets import generated
from idfslam.errors import ConfigError, RecordingError


@dataclass(frozen=True)
class Entry:
    """A recording of the benchmark and how many of its frames."""

    name: str
    path: str
    frames: int | None = None  # None: all

    @property
    def gt_mesh(self) -> Path | None:
        """The true mesh in the recording's folder; None where there is none (a generated recording brings its own)."""
        place = Path(generated.kidnapped_path(self.path) or self.path)
        mesh = (place if place.is_dir() else place.parent) / "gt_mesh.ply"
        return mesh if place.exists() and mesh.is_file() else None


def listed(recordings: Sequence[str], frames: int | None = None, *, unique: bool = True) -> list[Entry]:
    """The recordings by name; `@FRAMES` wins over `frames`. `unique`: recordings of one name are told apart by their parent folders.

    Raises RecordingError for one that is missing, ConfigError where there is none or, if they are to be unique, for one repeated.
    """
    if not recordings:
        raise ConfigError(f"no recordings, expected at least one: paths, {generated.FORMS}, with @FRAMES if wanted")
    entries = [_entry(text, frames) for text in recordings]
    return _unique(entries) if unique else entries


def _unique(entries: Sequence[Entry]) -> list[Entry]:
    counts = Counter(entry.name for entry in entries)
    found = [replace(e, name=f"{Path(e.path).parent.name}-{e.name}") if counts[e.name] > 1 else e for e in entries]
    twice = [name for name, count in Counter(entry.name for entry in found).items() if count > 1]
    if twice:
        raise ConfigError(f"{', '.join(twice)}: listed twice, expected recordings whose last two folders differ, each once")
    return found


def _entry(text: str, frames: int | None) -> Entry:
    path, mark, count = text.rpartition("@")
    if mark and count.isdigit() and not Path(text).exists():
        if int(count) < 1:
            raise ConfigError(f"{text}: expected at least 1 frame after the @")
        frames = int(count)
    else:
        path = text
    inner = generated.kidnapped_path(path)
    if inner is not None:
        entry = _entry(inner, frames)
        return replace(entry, name=f"kidnap-{entry.name}", path=generated.KIDNAP + entry.path)
    if generated.kind_of(path) is not None:
        return Entry(path.replace(":", "-"), path, frames)
    if not Path(path).exists():
        raise RecordingError(f"{path}: no such file or folder, expected a recording, {generated.FORMS}, with @FRAMES if wanted")
    place = Path(path).resolve()
    return Entry(place.stem if place.is_file() else place.name, str(place), frames)
