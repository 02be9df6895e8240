"""The files in .github: they are YAML, and what they run exists."""

import re
from pathlib import Path
from typing import Any

import pytest
import yaml

ROOT = Path(__file__).parent.parent
WORKFLOWS = sorted((ROOT / ".github/workflows").glob("*.yml"))
FORMS = sorted((ROOT / ".github/ISSUE_TEMPLATE").glob("*.yml"))
TARGETS = set(re.findall(r"(?m)^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8")))


def read(path: Path) -> dict[Any, Any]:
    values = yaml.safe_load(path.read_text(encoding="utf-8"))
    assert isinstance(values, dict)
    return values


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.stem)
def test_workflows_run_what_exists(path: Path) -> None:
    for name, job in read(path)["jobs"].items():
        commands = "\n".join(step["run"] for step in job["steps"] if "run" in step)
        assert commands, name
        assert set(re.findall(r"\bmake ([a-z-]+)", commands)) <= TARGETS
        assert all((ROOT / file).is_file() for file in re.findall(r"(\.ci/\w+)", commands))
        assert job["timeout-minutes"] <= 300


def test_every_supported_system_and_python_is_tried() -> None:
    jobs = read(ROOT / ".github/workflows/ci.yml")["jobs"]
    rows = [row for job in jobs.values() for row in job["strategy"]["matrix"]["include"]]
    assert {row["os"] for row in rows} == {"ubuntu-latest", "windows-latest", "macos-latest"}
    assert {row["python"] for row in rows} == {"3.10", "3.11", "3.12", "3.13", "3.14"}
    assert all(row["os"] == "ubuntu-latest" and row["python"] != "3.14" for row in rows if not row.get("may_fail"))


@pytest.mark.parametrize("path", [path for path in FORMS if path.stem != "config"], ids=lambda path: path.stem)
def test_forms_for_issues_ask_for_something(path: Path) -> None:
    form = read(path)
    assert {"name", "description", "body"} <= set(form)
    asked = [item for item in form["body"] if item["type"] != "markdown"]
    assert len({item["id"] for item in asked}) == len(asked) > 0
    assert all(item["attributes"]["label"] for item in asked)
    assert any(item.get("validations", {}).get("required") for item in asked)
