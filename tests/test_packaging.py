"""The packages that are needed: declared in pyproject.toml, with a tested version each, and the same ones in messages."""

import re
from pathlib import Path

ROOT = Path(__file__).parent.parent


def name_of(requirement: str) -> str:
    """The package of a requirement or a line of constraints, as installers compare names."""
    match = re.match(r"[\w.-]+", requirement)
    assert match is not None
    return re.sub(r"[-_.]+", "-", match[0]).lower()


def declared() -> set[str]:
    """The packages of all dependencies and extras."""
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    part = text[text.index("\ndependencies = [") : text.index("[project.scripts]")]
    return {name_of(requirement) for requirement in re.findall(r'"([^"]+)"', part)} - {"idf-slam"}


def test_each_package_has_a_tested_version() -> None:
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    constrained = {name_of(line) for line in lines if line and not line.startswith("#")}
    assert len(declared()) > 30
    assert sorted(declared() - constrained) == []


def test_a_version_for_newer_pythons_has_one_for_3_10() -> None:
    lines = [line.split(";") for line in (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines() if ";" in line]
    newer, older = ({name_of(line) for line, rule in lines if sign in rule} for sign in (">=", "< "))
    assert newer == older


def test_messages_name_declared_packages() -> None:
    sources = (path.read_text(encoding="utf-8") for path in (ROOT / "src").rglob("*.py"))
    named = {name_of(package) for text in sources for package in re.findall(r"pip_install\(['\"]([\w.-]+)", text)}
    assert len(named) > 8
    assert sorted(named - declared()) == []
