"""docs/presets.md has every value of the presets `imap` and `nice`, with its source."""

import dataclasses
import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from idfslam.config import IMAP, NICE, Config

PAGE = (Path(__file__).parent.parent / "docs/presets.md").read_text(encoding="utf-8")
PRESETS = {"imap": IMAP, "nice": NICE}
ROW = re.compile(r"^\| `(?P<section>\w+)\.(?P<key>\w+)` \| (?P<value>[^|]+) \| (?P<source>[^|]+) \|$", re.MULTILINE)


def table(preset: str) -> list[tuple[str, str, Any, str]]:
    """The rows of a preset's table: section, key, value, source."""
    part = PAGE.split(f"\n## {preset}\n")[1].split("\n## ")[0]
    return [(m["section"], m["key"], yaml.safe_load(m["value"]), m["source"].strip()) for m in ROW.finditer(part)]


@pytest.mark.parametrize("preset", PRESETS)
def test_every_row_is_the_presets_value(preset: str) -> None:
    rows = table(preset)
    assert len(rows) > 25
    for section, key, value, source in rows:
        assert getattr(getattr(PRESETS[preset], section), key) == value, f"{section}.{key}"
        assert len(source) > 3, f"{section}.{key} has no source"


def unlike(preset: Config) -> set[str]:
    """The values of mapper and keyframes that a preset sets, and all values of the parts that it alone has."""
    own = {"imap": "volume_density", "nice": "occupancy_grids"}[preset.preset]
    found = set()
    for section in (own, "joint_mapping", "inverse_rendering"):
        found |= {f"{section}.{f.name}" for f in dataclasses.fields(getattr(preset, section)) if f.name != "weights"}
    for section in ("mapper", "keyframes"):
        mine, default = getattr(preset, section), getattr(Config(), section)
        found |= {f"{section}.{f.name}" for f in dataclasses.fields(mine) if getattr(mine, f.name) != getattr(default, f.name)}
    return found - {"mapper.background", "mapper.light", "keyframes.least_sharpness"}  # parts of this package that both leave out


@pytest.mark.parametrize("preset", PRESETS)
def test_no_value_is_left_out(preset: str) -> None:
    assert unlike(PRESETS[preset]) <= {f"{section}.{key}" for section, key, _, _ in table(preset)}
