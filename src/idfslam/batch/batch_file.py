"""The list of a batch: recordings, each with values of its own, in a text or YAML file, or named one by one.

    # recording              what `run` takes, without the dashes
    /data/kitchen
    "/data/my office"        frames=500 camera.fx=525 camera.fy=525 camera.cx=319.5 camera.cy=239.5
    synthetic:3:kinect       seed=1 out=room-3 mapper.pixels=256

In YAML an entry is a path, or a mapping with `path` and the same names, nested or with dots. Relative paths count from the list's folder.
"""

import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import yaml

from idfslam.batch.recordings import Entry, listed
from idfslam.config import Config, check, update
from idfslam.datasets import generated
from idfslam.errors import ConfigError

_SUFFIXES = (".txt", ".yaml", ".yml")


@dataclass(frozen=True)
class Pinhole:
    """What `run` takes as --camera.*; 0: not given."""

    fx: float = 0.0
    fy: float = 0.0
    cx: float = 0.0
    cy: float = 0.0
    depth_scale: float = 0.0


@dataclass(frozen=True)
class Options:
    """What an entry may say beside config values."""

    out: str = ""
    start: int = 0
    frames: int = 0
    stride: int = 1
    format: str = ""
    camera: Pinhole = Pinhole()


@dataclass(frozen=True)
class Item:
    """A recording of the batch, the name of its result folder, and the flags of its run."""

    name: str
    path: str
    flags: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Line:
    where: str
    path: str
    values: dict[str, Any] = field(default_factory=dict)  # nested


def read_batch(arguments: Sequence[str], config: Config) -> list[Item]:
    """The recordings of `arguments`: paths, synthetic[:SEED][:kinect], PATH@FRAMES, or files that list such (.txt, .yaml, .yml).

    Raises ConfigError for a list that cannot be read and a value that cannot be, RecordingError for a missing recording.
    """
    lines = [line for argument in arguments for line in _lines(argument)]
    given = [_options(line, config) for line in lines]
    entries = listed([line.path for line in lines], unique=False)
    names = [str(options.get("out") or entry.name) for options, entry in zip(given, entries)]
    return [_item(entry, options) for entry, options in zip(_unique(entries, names), given)]


def _unique(entries: list[Entry], names: list[str]) -> list[Entry]:
    """Entries by these names, a number behind those that come again: one recording may be run with several values."""
    found: list[Entry] = []
    for entry, name in zip(entries, names):
        taken = {e.name for e in found}
        candidates = (name if i == 1 else f"{name}-{i}" for i in range(1, len(entries) + 1))
        found.append(replace(entry, name=next(c for c in candidates if c not in taken)))
    return found


def _item(entry: Entry, options: Mapping[str, Any]) -> Item:
    given = {"frames": entry.frames, **options} if entry.frames is not None else dict(options)
    given.pop("out", None)
    return Item(entry.name, entry.path, tuple(_flags(given)))


def _lines(argument: str) -> Iterator[_Line]:
    path = Path(argument)
    if path.suffix not in _SUFFIXES:
        yield _Line(argument, argument)
        return
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: cannot be read ({error}); expected a list of recordings") from error
    found = list(_text_lines(path, text) if path.suffix == ".txt" else _yaml_lines(path, text))
    if not found:
        raise ConfigError(f"{path}: no recordings in it, expected one a line, with options such as frames=500")
    yield from (replace(line, path=_place(line.path, path.parent)) for line in found)


def _text_lines(path: Path, text: str) -> Iterator[_Line]:
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
            raise ConfigError(f"{where}: '{wrong[0]}', expected NAME=VALUE; a path with spaces stands in quotes")
        yield _Line(where, words[0], _nested({name: yaml.safe_load(value) for name, _, value in pairs}, where))


def _yaml_lines(path: Path, text: str) -> Iterator[_Line]:
    try:
        found = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise ConfigError(f"{path}: is not YAML ({' '.join(str(error).split())})") from error
    if not isinstance(found, list):
        raise ConfigError(
            f"{path}: found {type(found).__name__}, expected a list of recordings: '- PATH' or '- {{path: PATH, frames: 500}}'"
        )
    for number, entry in enumerate(found, 1):
        where = f"{path}: entry {number}"
        values = {"path": entry} if isinstance(entry, str) else dict(entry) if isinstance(entry, dict) else {}
        place = values.pop("path", None)
        if not isinstance(place, str):
            raise ConfigError(f"{where}: {entry!r}, expected a path or a mapping with 'path'")
        yield _Line(where, place, _nested(values, where))


def _place(path: str, folder: Path) -> str:
    inner = generated.kidnapped_path(path)
    if inner is not None:
        return generated.KIDNAP + _place(inner, folder)
    return path if generated.kind_of(path.partition("@")[0]) is not None else str(folder / Path(path).expanduser())


def _nested(values: Mapping[Any, Any], where: str) -> dict[str, Any]:
    """`{a.b: 1}` -> `{a: {b: 1}}`."""
    found: dict[str, Any] = {}
    for name, value in values.items():
        *sections, last = str(name).split(".")
        place = found
        for section in sections:
            place = place.setdefault(section, {})
            if not isinstance(place, dict):
                raise ConfigError(f"{where}: '{section}' is a value and a section")
        place[last] = value
    return found


def _options(line: _Line, config: Config) -> dict[str, Any]:
    """What the entry gives, checked as `run` would."""
    of_run = {key: value for key, value in line.values.items() if key in Options.__dataclass_fields__}
    of_config = {key: value for key, value in line.values.items() if key not in of_run}
    if "preset" in of_config:
        raise ConfigError(f"{line.where}: 'preset' holds for the whole batch: give it as --preset")
    options: Options = update(Options(), of_run, line.where)
    if options.start < 0 or options.stride < 1 or ("frames" in of_run and options.frames < 1):
        raise ConfigError(
            f"{line.where}: start {options.start}, stride {options.stride}, frames {options.frames}, expected at least 0, 1 and 1"
        )
    if Path(options.out).is_absolute() or ".." in Path(options.out).parts:
        raise ConfigError(f"{line.where}: out '{options.out}', expected a folder's name inside --out")
    check(update(config, of_config, line.where))
    return line.values


def _flags(values: Mapping[str, Any], section: str = "") -> Iterator[str]:
    for name, value in values.items():
        flag = section + name.replace("_", "-")
        if isinstance(value, dict):
            yield from _flags(value, f"{flag}.")
        elif isinstance(value, bool):
            yield f"--{section}{'' if value else 'no-'}{name.replace('_', '-')}"
        elif value is not None:
            yield from (f"--{flag}", str(value))
