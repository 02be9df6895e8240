"""The packages' layers: docs/design.md names the layers that `lint-imports` enforces, and the package's root stays small."""

import re
from itertools import groupby
from pathlib import Path
from typing import Any

import pytest
from importlinter.api import read_configuration

ROOT = Path(__file__).parent.parent


@pytest.fixture
def contracts() -> dict[str, dict[str, Any]]:
    """The contracts of pyproject.toml by their id."""
    options = read_configuration(str(ROOT / "pyproject.toml"))["contracts_options"]
    return {contract["id"]: contract for contract in options}


def test_the_table_of_layers_is_the_contract(contracts: dict[str, dict[str, Any]]) -> None:
    section = (ROOT / "docs/design.md").read_text(encoding="utf-8").split("\n## Layers\n")[1].split("\n## ")[0]
    rows = re.findall(r"^\| (\d+) \| `(\w+)(?:/|\.py)` \|", section, re.MULTILINE)
    documented = [(int(number), {package for _, package in group}) for number, group in groupby(rows, key=lambda row: row[0])]
    enforced = [set(layer.split(" | ")) for layer in contracts["layers"]["layers"]]
    assert documented == list(enumerate(enforced, start=1))


def test_the_contracts_hold_for_all_packages(contracts: dict[str, dict[str, Any]]) -> None:
    assert contracts["layers"]["exhaustive"] == "True"
    assert contracts["layers"]["containers"] == contracts["circles"]["ancestors"] == ["idfslam"]


def test_the_root_holds_what_all_packages_share() -> None:
    files = {path.name for path in (ROOT / "src/idfslam").iterdir() if path.is_file()}
    assert files == {"__init__.py", "__init__.pyi", "errors.py", "frame.py", "frame_images.py", "py.typed"}
