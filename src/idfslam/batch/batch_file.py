"""Reads the recordings of a batch, each with its own values, from the command line and from text or YAML files.

    # recording              options of `run`, without the dashes
    /data/kitchen
    "/data/my office"        frames=500 camera.fx=525 camera.fy=525 camera.cx=319.5 camera.cy=239.5
    synthetic:3:kinect       seed=1 out=room-3 mapper.pixels=256

In YAML an entry is a path, or a mapping with `path` and the same names, nested or with dots. Relative paths start at the file's folder.
"""

import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from idfslam.batch.recordings import RecordingSpec, parse_recordings
from idfslam.config import Config, check, update
from idfslam.datasets import generated
from idfslam.errors import ConfigError
from idfslam.storage.plain_values import one_line, shown
from idfslam.storage.text_file import read_text
from idfslam.storage.yaml_text import parse_yaml

_SUFFIXES = (".txt", ".yaml", ".yml")


@dataclass(frozen=True)
class CameraOptions:
    """The options --camera.* of `run`, with values of their types: what an entry does not name is not given."""

    fx: float = 0.0
    fy: float = 0.0
    cx: float = 0.0
    cy: float = 0.0
    depth_scale: float = 0.0
    readout: float = 0.0
    depth_readout: float = 0.0
    depth_delay: float = 0.0


@dataclass(frozen=True)
class RunOptions:
    """The options that an entry may have besides config values."""

    out: str = ""
    start: int = 0
    frames: int = 0
    stride: int = 1
    truth: bool = True
    format: str = ""
    camera: CameraOptions = CameraOptions()


@dataclass(frozen=True)
class BatchJob:
    """One run of the batch: the recording, the name of its result folder, and the command-line flags."""

    name: str
    path: str
    flags: tuple[str, ...] = ()


@dataclass(frozen=True)
class _ListEntry:
    """A recording as it is written in a list."""

    where: str  # file and line, for messages
    path: str
    values: dict[str, Any] = field(default_factory=dict)  # options and config values, nested by section


def read_batch(arguments: Sequence[str], config: Config) -> list[BatchJob]:
    """The runs of `arguments`: recordings as `parse_recordings` takes them, or files that list such (.txt, .yaml, .yml).

    Raises ConfigError for an unreadable list or an invalid value, RecordingError for a missing recording.
    """
    entries = [entry for argument in arguments for entry in _read_entries(argument)]
    options = [_checked_options(entry, config) for entry in entries]
    recordings = parse_recordings([entry.path for entry in entries], unique=False)
    names = _unique_names([str(values.get("out") or recording.name) for values, recording in zip(options, recordings)])
    return [_job(name, recording, values) for name, recording, values in zip(names, recordings, options)]


def _unique_names(names: Sequence[str]) -> list[str]:
    """The names, with a number behind a repeated one: a recording may be run several times with different values."""
    unique: list[str] = []
    for name in names:
        candidates = (name if i == 1 else f"{name}-{i}" for i in range(1, len(names) + 1))
        unique.append(next(candidate for candidate in candidates if candidate not in unique))
    return unique


def _job(name: str, recording: RecordingSpec, options: Mapping[str, Any]) -> BatchJob:
    flags = {"frames": recording.frames, **options} if recording.frames is not None else dict(options)
    flags.pop("out", None)
    return BatchJob(name, recording.path, tuple(_flags(flags)))


def _read_entries(argument: str) -> Iterator[_ListEntry]:
    """The entries of a list, or the recording that the argument names itself."""
    path = Path(argument)
    if path.suffix not in _SUFFIXES:
        yield _ListEntry(argument, argument)
        return
    try:
        text = read_text(path)
    except (OSError, ValueError) as error:  # ValueError: no path at all
        raise ConfigError(f"{one_line(argument)}: cannot be read ({shown(error)}); expected a list of recordings") from error
    if "\0" in text:
        raise ConfigError(f"{path}: holds a NUL, expected text: a list of recordings")
    entries = list(_text_entries(path, text) if path.suffix == ".txt" else _yaml_entries(path, text))
    if not entries:
        raise ConfigError(f"{path}: lists no recordings, expected one on each line, with options such as frames=500")
    yield from (replace(entry, path=_absolute(entry.path, path.parent)) for entry in entries)


def _text_entries(path: Path, text: str) -> Iterator[_ListEntry]:
    for number, line in enumerate(text.splitlines(), 1):
        where = f"{path}:{number}"
        try:
            words = shlex.split(line, comments=True)
        except ValueError as error:
            raise ConfigError(f"{where}: {error}, expected a recording and options such as frames=500") from error
        if not words:
            continue
        pairs = [word.partition("=") for word in words[1:]]
        wrong = [name for name, mark, _ in pairs if not mark]
        if wrong:
            raise ConfigError(f"{where}: {shown(wrong[0])}, expected NAME=VALUE; put a path with spaces in quotes")
        yield _ListEntry(where, words[0], _nested({name: _value(value, where) for name, _, value in pairs}, where))


def _value(text: str, where: str) -> Any:
    return parse_yaml(text, source=where, error=ConfigError, expected="a list of recordings, or a value of one")


def _yaml_entries(path: Path, text: str) -> Iterator[_ListEntry]:
    entries = _value(text, str(path))
    if not isinstance(entries, list):
        raise ConfigError(
            f"{path}: found {type(entries).__name__}, expected a list of recordings: '- PATH' or '- {{path: PATH, frames: 500}}'"
        )
    for number, entry in enumerate(entries, 1):
        where = f"{path}: entry {number}"
        values = {"path": entry} if isinstance(entry, str) else dict(entry) if isinstance(entry, dict) else {}
        recording = values.pop("path", None)
        if not isinstance(recording, str):
            raise ConfigError(f"{where}: {shown(entry)}, expected a path or a mapping with 'path'")
        yield _ListEntry(where, recording, _nested(values, where))


def _absolute(path: str, folder: Path) -> str:
    inner = generated.kidnapped_path(path)
    if inner is not None:
        return generated.KIDNAP + _absolute(inner, folder)
    return path if generated.kind_of(path.partition("@")[0]) is not None else str(folder / Path(path).expanduser())


def _nested(values: Mapping[Any, Any], where: str) -> dict[str, Any]:
    """`{a.b: 1}` -> `{a: {b: 1}}`."""
    nested: dict[str, Any] = {}
    for name, value in values.items():
        *sections, last = str(name).split(".")
        inner = nested
        for section in sections:
            inner = inner.setdefault(section, {})
            if not isinstance(inner, dict):
                raise ConfigError(f"{where}: {shown(section)} is given as a value and as a section")
        inner[last] = value
    return nested


def _checked_options(entry: _ListEntry, config: Config) -> dict[str, Any]:
    """The entry's values, checked as `run` would check them."""
    of_run = {key: value for key, value in entry.values.items() if key in RunOptions.__dataclass_fields__}
    of_config = {key: value for key, value in entry.values.items() if key not in of_run}
    if "preset" in of_config:
        raise ConfigError(f"{entry.where}: 'preset' is the same for the whole batch: give it as --preset")
    options: RunOptions = update(RunOptions(), of_run, entry.where)
    if options.start < 0 or options.stride < 1 or ("frames" in of_run and options.frames < 1):
        values = f"start {options.start}, stride {options.stride}, frames {options.frames}"
        raise ConfigError(f"{entry.where}: {values}, expected at least 0, 1 and 1")
    if Path(options.out).is_absolute() or ".." in Path(options.out).parts:
        raise ConfigError(f"{entry.where}: out '{options.out}', expected the name of a folder inside --out")
    check(update(config, of_config, entry.where))
    return entry.values


def _flags(values: Mapping[str, Any], section: str = "") -> Iterator[str]:
    """Command-line flags that set nested values."""
    for name, value in values.items():
        flag = section + name.replace("_", "-")
        if isinstance(value, dict):
            yield from _flags(value, f"{flag}.")
        elif isinstance(value, bool):
            yield f"--{section}{'' if value else 'no-'}{name.replace('_', '-')}"
        elif value is not None:
            yield from (f"--{flag}", str(value))
