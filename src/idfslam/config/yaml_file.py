"""Configurations as YAML: written next to a run's results, read back, and checked."""

import math
from dataclasses import asdict, is_dataclass, replace
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

import yaml

from idfslam.config.config import Config
from idfslam.config.fields import bounds, field_types
from idfslam.config.presets import PRESETS
from idfslam.config.tracking_sections import PretrainConfig
from idfslam.errors import ConfigError
from idfslam.storage import yaml_text
from idfslam.storage.plain_values import shown

AnyConfig = TypeVar("AnyConfig", Config, PretrainConfig)

RUN_SECTIONS = ("recording", "versions")  # sections of a run's config.yaml that are no part of a Config
RENAMED = {
    "mapper.beside": "mapper.background",
    "mapper.known": "mapper.min_mapped_share",
    "mapper.final_updates": "refinement.updates",
    "mapper.final_keyframes": "refinement.keyframes",
    "mapper.final_rounds": "refinement.rounds",
    "mapper.final_seconds": "refinement.seconds",
    "keyframes.linked_within": "keyframes.edge_length",
    "finetune.guard": "finetune.validate_every",
    "finetune.held_out": "finetune.validation_pairs",
    "alignment.enabled": "front_end",
    "alignment.hold": "alignment.prior_information",
    "alignment.hold_registered": "alignment.registration_prior_information",
    "alignment.min_stiffness": "alignment.min_eigenvalue",
    "alignment.refined": "refinement.poses_per_update",
    "alignment.refine_reach": "refinement.max_shift",
    "loops.piece_after": "loops.submap_after",
    "loops.agreeing": "loops.merge_confirmations",
    "loops.agreeing_span": "loops.merge_span",
    "loops.relearnt": "loops.relearn_updates",
}
"""Keys of earlier versions, which are refused with their new names."""
_LARGEST = 2**31 - 1  # of a whole number; raised, numbers pass that numpy and torch refuse in words of their own


def dump(config: Any) -> dict[str, Any]:
    """The values as YAML can hold them: tuples become lists, paths text."""

    def plain(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: plain(inner) for key, inner in value.items()}
        if isinstance(value, tuple):
            return list(value)
        return str(value) if isinstance(value, Path) else value

    values: dict[str, Any] = plain(asdict(config))
    return values


def as_yaml(config: Config) -> str:
    """All values as the text of a file that `load` reads."""
    return yaml.safe_dump(dump(config), sort_keys=False)


def load(path: Path, *, base: str | None = None) -> Config:
    """A config from a YAML file, whose values replace those of a preset: of `base`, or without one of the preset that the file names.

    Raises ConfigError for a file that is no YAML mapping, for unknown sections, keys or presets, and for values that are not allowed.
    """
    values = {key: value for key, value in read_yaml(path).items() if key not in RUN_SECTIONS}
    if base is not None:
        values["preset"] = base
    return check(update(preset(str(values.get("preset", "fast"))), values, path))


def read_yaml(path: Path) -> dict[str, Any]:
    """The mapping in a YAML file. Raises ConfigError if it cannot be read or is something else."""
    values = yaml_text.read_yaml(path, error=ConfigError, expected="a file such as a run's config.yaml")
    if not isinstance(values, dict) or not all(isinstance(key, str) for key in values):
        found = "a key that is no text" if isinstance(values, dict) else type(values).__name__
        raise ConfigError(f"{path}: found {found}, expected a mapping of config sections")
    return values


def preset(name: str) -> Config:
    """The preset of that name. Raises ConfigError if there is none."""
    if name not in PRESETS:
        raise ConfigError(f"preset {shown(name)} does not exist; choose one of {', '.join(PRESETS)}")
    return PRESETS[name]


def update(config: Any, values: dict[str, Any], where: Path | str, *, section: str = "") -> Any:
    """`config` with nested `values` in place of its own; `section` is its name within a larger config, with a dot behind it.

    Raises ConfigError for a key that it does not have, naming the key's new name if there is one, and for a value of another type.
    """
    types = get_type_hints(type(config))
    changes: dict[str, Any] = {}
    for key, value in values.items():
        name = f"{section}{key}"
        if name in RENAMED:
            raise ConfigError(f"{where}: unknown key '{name}'; its name is now '{RENAMED[name]}'")
        if key not in types:
            raise ConfigError(f"{where}: unknown key {shown(key)}; {type(config).__name__} has {', '.join(types)}")
        old = getattr(config, key)
        if not is_dataclass(old):
            changes[key] = _converted(value, types[key], old, f"{where}: '{key}'")
        elif isinstance(value, dict):
            changes[key] = update(old, value, where, section=f"{name}.")
        else:
            raise ConfigError(f"{where}: '{key}' is {shown(value)}, expected a section of {', '.join(get_type_hints(type(old)))}")
    return replace(config, **changes)


def _converted(value: Any, field_type: Any, old: Any, name: str) -> Any:
    """A value from YAML as its field's type. Raises ConfigError, naming `old` as an example, where it is of another type."""
    if get_origin(field_type) is Literal:
        if value not in get_args(field_type):
            raise ConfigError(f"{name} is {shown(value)}; choose one of {', '.join(map(str, get_args(field_type)))}")
        return value
    if Path in get_args(field_type):
        if value is not None and not isinstance(value, str):
            raise ConfigError(f"{name} is {shown(value)}, expected a path")
        return Path(value) if value else None
    numeric = isinstance(value, int | float) and not isinstance(value, bool)
    if field_type is float and numeric:
        return float(value)
    if get_origin(field_type) is tuple and isinstance(value, list) and all(isinstance(v, int | float) for v in value):
        return tuple(float(v) for v in value)
    if type(value) is not field_type:
        raise ConfigError(f"{name} is {shown(value)}, expected a value like {old!r}")
    return value


def check(config: AnyConfig) -> AnyConfig:
    """The same config, if its numbers are allowed: finite, at least 0, and within the bounds of their fields.

    Raises ConfigError for the first that is not.
    """
    _check_section(config, "")
    return config


def _check_section(section: Any, prefix: str) -> None:
    for key, field_type in field_types(type(section)).items():
        value, name = getattr(section, key), f"{prefix}{key}"
        if is_dataclass(value):
            _check_section(value, f"{name}.")
            continue
        numbers = [v for v in (value if isinstance(value, tuple) else (value,)) if isinstance(v, int | float)]
        if any((isinstance(v, float) and not math.isfinite(v)) or v < 0 for v in numbers):
            raise ConfigError(f"{name} is {shown(value)}, expected a finite number of at least 0")
        if any(isinstance(v, int) and v > _LARGEST for v in numbers):
            raise ConfigError(f"{name} is {shown(value)}, expected at most {_LARGEST}")
        for bound in bounds(field_type):
            if not all(bound.allows(v) for v in numbers):
                raise ConfigError(f"{name} is {value}, expected {bound}")
