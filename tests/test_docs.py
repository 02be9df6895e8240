"""The documentation site: every value and command is in it, and it builds without a warning."""

import os
import re
import subprocess
import sys
from dataclasses import asdict
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

import pytest

from helpers.docs_module import docs_module
from idfslam.config import FAST, PRETRAIN

ROOT = Path(__file__).parent.parent

pytestmark = pytest.mark.skipif(
    find_spec("mkdocs") is None or find_spec("mkdocstrings") is None, reason="mkdocs is not installed: pip install 'idf-slam[docs]'"
)


@pytest.fixture(scope="module")
def reference() -> ModuleType:
    return docs_module("reference")


def test_every_value_of_the_configuration_has_a_row_with_its_meaning(reference: ModuleType) -> None:
    rows = {line.split("`")[1]: line for line in reference.configuration().splitlines() if line.startswith("| `")}
    names = {key for key, value in asdict(FAST).items() if not isinstance(value, dict)} | set(asdict(PRETRAIN))
    names |= {f"{section}.{key}" for section, values in asdict(FAST).items() if isinstance(values, dict) for key in values}
    assert set(rows) == names
    assert all(len(line.rstrip(" |").rsplit("|", 1)[1]) > 3 for line in rows.values())
    assert rows["field.width"] == "| `field.width` | `32` | `256` | Width of the trunk (Sec. IV: 256). |"
    assert rows["tracker.grid"].startswith("| `tracker.grid` | `4` |  | The image is divided into grid x grid cells")
    assert rows["mesh.resolution"].startswith("| `mesh.resolution` ★ | `0.02` | Cell edge of marching cubes [m].")
    assert {name for name, row in rows.items() if " ★ |" in row} == USER_OPTIONS


USER_OPTIONS = {
    *("preset", "seed", "device", "refine", "calibrate", "keyframes.translation", "tracker.weights", "finetune.enabled"),
    *("loops.enabled", "mesh.resolution", "archive", "movers"),
    *("steps", "batch", "height", "crop", "gap", "learning_rate", "augmentation"),  # of pretrain
}


def test_every_command_is_there_without_the_configuration(reference: ModuleType) -> None:
    text = reference.commands()
    files = {path.stem.replace("_", "-") for path in (ROOT / "src/idfslam/cli/commands").glob("*.py")} - {"--init--", "command"}
    assert set(re.findall(r"## idf-slam ([\w-]+)", text)) == files
    assert "--retries INT" in text
    assert "--mapper.pixels" not in text.replace("`--mapper.pixels", "")
    assert "--help-all" not in text
    assert text.count("configuration.md") == 9
    assert "╭" not in text


@pytest.mark.parametrize("page", sorted((ROOT / "docs").glob("*.md")), ids=lambda page: page.stem)
def test_lists_begin_after_an_empty_line(page: Path) -> None:
    """Without it the site shows a list as a part of the paragraph before."""
    text = re.sub(r"(?ms)^```.*?^```", "```", page.read_text(encoding="utf-8"))
    blocks = re.split(r"\n\s*\n", text)
    assert not [block for block in blocks if re.search(r"(?m)^[^\s#|`>-].*\n- ", block) and not block.startswith("- ")]


@pytest.mark.slow
def test_the_site_builds_without_a_warning(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(tmp_path)]
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1", "PYTHONPATH": str(ROOT / "src")}
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, env=environment)
    assert (done.returncode, done.stderr) == (0, "")
    assert "mapper.sharpness" in (tmp_path / "reference/configuration/index.html").read_text(encoding="utf-8")
    assert "Tracks a frame. Then maps it if it becomes a keyframe" in (tmp_path / "reference/api/index.html").read_text(encoding="utf-8")
