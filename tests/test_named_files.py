"""Files and functions that docstrings, comments and the page about the design name are there."""

import re
from pathlib import Path

ROOT = Path(__file__).parent.parent
SOURCES = sorted((ROOT / "src/idfslam").rglob("*.py"))
PAGES = [*SOURCES, ROOT / "docs/design.md", ROOT / "CONTRIBUTING.md"]
SUFFIXES = ("py", "txt", "npz", "json", "csv", "yaml", "ply", "rrd", "cff", "toml", "png", "html", "safetensors")


def named(pattern: str) -> list[tuple[Path, re.Match[str]]]:
    """What stands in backticks and is of this form, with its page."""
    return [(page, found) for page in PAGES for found in re.finditer(f"`{pattern}`", page.read_text(encoding="utf-8"))]


def test_files_exist() -> None:
    there = [
        "/" + path.relative_to(ROOT).as_posix()
        for folder in ("src", "tests", "benchmarks", "examples")
        for path in (ROOT / folder).rglob("*.py")
    ]
    missing = [
        f"{page.name}: {found[1]}" for page, found in named(r"([\w/]+\.py)") if not any(path.endswith("/" + found[1]) for path in there)
    ]
    assert not missing


def test_what_a_module_is_said_to_have_is_in_it() -> None:
    """Or among the values of the configuration: `config.points` is one, and no module's."""
    modules: dict[str, str] = {}
    for path in SOURCES:
        modules[path.stem] = modules.get(path.stem, "") + path.read_text(encoding="utf-8")
    values = "".join(path.read_text(encoding="utf-8") for path in SOURCES if path.parent.name == "config")
    missing = set[str]()
    for page, found in named(r"(?:\w+\.)*(\w+)\.(\w+)"):
        module, name = found.groups()
        if module in modules and name not in SUFFIXES and not re.search(rf"\b{name}\b", modules[module] + values):
            missing.add(f"{page.name}: {found[0]}")
    assert not missing
