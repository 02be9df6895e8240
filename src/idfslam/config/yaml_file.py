"""Configurations as YAML: written beside a run's results, read back, and checked."""

import math
from dataclasses import asdict, is_dataclass, replace
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

import yaml

from idfslam.config.presets import PRESETS
from idfslam.config.sections import Config, PretrainConfig
from idfslam.errors import ConfigError

Checked = TypeVar("Checked", Config, PretrainConfig)

RUN_SECTIONS = ("recording", "versions")  # what a run's config.yaml tells beside the values: no part of a Config
_AT_LEAST_ONE = {
    *("field.layers", "field.width", "field.levels", "field.features", "mapper.pixels", "mapper.samples", "mapper.cells"),
    *("tracker.height", "tracker.matches", "tracker.grid", "tracker.subsets", "alignment.points", "alignment.iterations"),
    *("finetune.pixels", "finetune.held_out"),
    *("steps", "batch", "height", "crop", "gap", "matches", "subsets", "queries"),  # of a PretrainConfig
}
_ABOVE_ZERO = {
    *("field.truncation", "field.coarsest", "field.finest", "mapper.sharpness", "mesh.resolution", "tracker.inlier_distance"),
    "temperature",
    "mapper.final_seconds",
}


def dump(config: Any) -> dict[str, Any]:
    """Plain values, ready for YAML."""

    def plain(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: plain(inner) for key, inner in value.items()}
        if isinstance(value, tuple):
            return list(value)
        return str(value) if isinstance(value, Path) else value

    values: dict[str, Any] = plain(asdict(config))
    return values


def load(path: Path, *, base: str | None = None) -> Config:
    """A config from YAML: the file's values over those of the preset `base`; without one, over the preset that the file names.

    Raises ConfigError for a file that is no YAML mapping, for unknown sections, keys or presets, and for values that cannot be.
    """
    values = {key: value for key, value in read_yaml(path).items() if key not in RUN_SECTIONS}
    if base is not None:
        values["preset"] = base
    return check(update(preset(str(values.get("preset", "fast"))), values, path))


def read_yaml(path: Path) -> dict[str, Any]:
    """The mapping in a YAML file. Raises ConfigError if it cannot be read or is something else."""
    try:
        values = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}; expected a YAML file such as a run's config.yaml") from error
    except (UnicodeDecodeError, yaml.YAMLError) as error:
        line = " ".join(str(error).split())
        raise ConfigError(f"{path}: is not YAML ({line}); expected a file such as a run's config.yaml") from error
    if not isinstance(values, dict):
        raise ConfigError(f"{path}: found {type(values).__name__}, expected a mapping of config sections")
    return values


def preset(name: str) -> Config:
    """The preset of that name. Raises ConfigError if there is none."""
    if name not in PRESETS:
        raise ConfigError(f"preset '{name}' does not exist; choose one of {', '.join(PRESETS)}")
    return PRESETS[name]


def update(config: Any, values: dict[str, Any], where: Path | str) -> Any:
    """`config` with nested `values` in place; raises ConfigError for a key it does not have or a value of another type."""
    hints = get_type_hints(type(config))
    changes: dict[str, Any] = {}
    for key, value in values.items():
        if key not in hints:
            raise ConfigError(f"{where}: unknown key '{key}'; {type(config).__name__} has {', '.join(hints)}")
        old = getattr(config, key)
        if not is_dataclass(old):
            changes[key] = _read(value, hints[key], old, f"{where}: '{key}'")
        elif isinstance(value, dict):
            changes[key] = update(old, value, where)
        else:
            raise ConfigError(f"{where}: '{key}' is {value!r}, expected a section of {', '.join(get_type_hints(type(old)))}")
    return replace(config, **changes)


def _read(value: Any, hint: Any, old: Any, name: str) -> Any:
    """A value from YAML as the type `hint` asks for it."""
    if get_origin(hint) is Literal:
        if value not in get_args(hint):
            raise ConfigError(f"{name} is {value!r}; choose one of {', '.join(map(str, get_args(hint)))}")
        return value
    if Path in get_args(hint):
        if value is not None and not isinstance(value, str):
            raise ConfigError(f"{name} is {value!r}, expected a path")
        return Path(value) if value else None
    numeric = isinstance(value, int | float) and not isinstance(value, bool)
    if hint is float and numeric:
        return float(value)
    if get_origin(hint) is tuple and isinstance(value, list) and all(isinstance(v, int | float) for v in value):
        return tuple(float(v) for v in value)
    if type(value) is not hint:
        raise ConfigError(f"{name} is {value!r}, expected a value like {old!r}")
    return value


def check(config: Checked) -> Checked:
    """The same config, if its numbers can be: finite, none negative, counts at least 1 where nothing works without.

    Raises ConfigError for the first that cannot.
    """
    for section, values in asdict(config).items():
        for key, value in values.items() if isinstance(values, dict) else [("", values)]:
            name = f"{section}.{key}" if key else section
            numbers = value if isinstance(value, tuple) else (value,)
            if any(isinstance(v, int | float) and (not math.isfinite(v) or v < 0) for v in numbers):
                raise ConfigError(f"{name} is {value}, expected a finite number of at least 0")
            if name in _AT_LEAST_ONE and min(numbers) < 1:
                raise ConfigError(f"{name} is {value}, expected at least 1")
            if name in _ABOVE_ZERO and value <= 0:
                raise ConfigError(f"{name} is {value}, expected more than 0")
    return config
