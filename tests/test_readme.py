"""What README.md and the pages of the guide name exists: files, commands, flags."""

import io
import re
from contextlib import redirect_stdout
from pathlib import Path

import pytest

from idfslam.cli import command_line
from idfslam.cli.command_line import hides_values

ROOT = Path(__file__).parent.parent
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
SHELL = re.compile(r"(?ms)^```sh\n(.*?)^```")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_links_lead_to_files(page: Path) -> None:
    targets = re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8"))
    generated = ("reference/",)  # made when the site is built
    assert not [target for target in targets if not (page.parent / target).exists() and not target.startswith(generated)]


def test_commands_and_flags_exist(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    named: dict[str, set[str]] = {}
    for page in PAGES:
        for block in SHELL.findall(page.read_text(encoding="utf-8")):
            for line in block.replace("\\\n", " ").splitlines():
                for command, rest in re.findall(r"\bidf-slam ([a-z-]+)\b([^#&]*)", line):
                    named.setdefault(command, set()).update(re.findall(r"(?<!\S)--[a-z][\w.-]*", rest))
    assert {"demo", "run", "eval", "mesh", "render", "export", "bench", "doctor"} <= set(named)
    for command, flags in named.items():
        known = set(re.findall(r"--[a-z][\w.-]*", help_of(command)))
        assert not flags - known - {"--help"}, command


def help_of(command: str) -> str:
    """All that the command's help says, with every value."""
    said = io.StringIO()
    with redirect_stdout(said), pytest.raises(SystemExit) as end:
        command_line.main([command, "--help-all" if hides_values(command) else "--help"])
    assert not end.value.code
    return said.getvalue()
