"""The pages that are generated when the site is built: every configuration value, and every command's --help."""

import ast
import inspect
import io
import os
import re
from contextlib import redirect_stdout
from dataclasses import fields, is_dataclass
from typing import Any
from unittest.mock import patch

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

from idfslam import config
from idfslam.cli import command_line
from idfslam.config import FAST, PAPER, PRETRAIN

_WIDTH = 96  # columns of the help texts
_SECTIONS = tuple(f.name for f in fields(FAST) if is_dataclass(getattr(FAST, f.name)))


def on_files(files: Files, config: MkDocsConfig, **_: Any) -> Files:
    """Adds the generated pages."""
    for name, text in {"configuration": configuration(), "commands": commands()}.items():
        files.append(File.generated(config, f"reference/{name}.md", content=text))
    return files


def configuration() -> str:
    """Every value: its flag, the two presets, what it means."""
    parts = [
        "# Configuration",
        "Every value is a flag of `demo`, `run`, `batch`, `bench` and `bench-pairs` (`--mapper.pixels 256`, `--mapper.no-active-sampling`) "
        "and a key of a YAML file for `--config` (a run's `config.yaml` is one). Flags win over the file, and it over `--preset`. "
        "`paper` holds the values of the paper's Sec. VI-A; where its column is empty, both presets agree.",
        "## The run as a whole",
        _table("", FAST, PAPER),
    ]
    for section in _SECTIONS:
        values = getattr(FAST, section)
        parts += [f"## {section}", str(inspect.getdoc(type(values))), _table(f"{section}.", values, getattr(PAPER, section))]
    parts += ["## Flags of pretrain", str(inspect.getdoc(config.PretrainConfig)), _table("", PRETRAIN, PRETRAIN)]
    return "\n\n".join(parts) + "\n"


def _table(prefix: str, fast: Any, paper: Any) -> str:
    two = paper is not fast
    rows = ["| value | default |" + (" paper |" if two else "") + " meaning |", "|---|---|" + ("---|" if two else "") + "---|"]
    for name, meaning in help_of(type(fast)).items():
        ours, theirs = getattr(fast, name), getattr(paper, name)
        cells = [f"`{prefix}{name}`", f"`{ours}`", *([f"`{theirs}`" if theirs != ours else ""] if two else []), meaning.replace("|", "\\|")]
        rows.append("| " + " | ".join(cells) + " |")
    return "\n".join(rows)


def help_of(kind: type) -> dict[str, str]:
    """What stands below each value of a config dataclass; its sections are left out."""
    (definition,) = ast.parse(inspect.getsource(kind)).body
    assert isinstance(definition, ast.ClassDef)
    found = {}
    for field, text in zip(definition.body, definition.body[1:]):
        if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name) and isinstance(text, ast.Expr):
            assert isinstance(text.value, ast.Constant)
            found[field.target.id] = " ".join(str(text.value.value).split())
    return found


def commands() -> str:
    """Every command's --help, without the configuration's values, which have a page of their own."""
    overview = _help()
    parts = ["# Command line", _block(overview)]
    for name in re.findall(r"• ([\w-]+)", overview):
        text, has_values = _without_values(_help(name))
        parts += [f"## idf-slam {name}", _block(text)]
        if has_values:
            parts.append("And every value of the [configuration](configuration.md) as `--SECTION.NAME`.")
    return "\n\n".join(parts) + "\n"


class _Terminal(io.StringIO):
    """Takes more than ASCII, as help texts with boxes need."""

    encoding = "utf-8"


def _help(*arguments: str) -> str:
    said = _Terminal()
    with redirect_stdout(said), patch.dict(os.environ, {"COLUMNS": str(_WIDTH), "NO_COLOR": "1"}):
        try:
            command_line.main([*arguments, "--help"])
        except SystemExit as end:
            assert not end.code
    return said.getvalue()


def _without_values(text: str) -> tuple[str, bool]:
    """The help without the boxes of configuration sections, and whether there were any."""
    boxes = re.split(r"(?m)^(?=╭─ )", text)
    kept = [box for box in boxes if not re.match(rf"╭─ ({'|'.join(_SECTIONS)}) options", box)]
    return "".join(kept), len(kept) < len(boxes)


def _block(text: str) -> str:
    """Boxes become titles and what stands in them."""
    lines = []
    for line in text.strip().splitlines():
        title = re.match(r"╭─ (.+?) ─*╮$", line)
        inside = re.match(r"│ (.*) │$", line)
        if title:
            lines += ["", f"{title[1]}:"]
        elif inside:
            lines.append(f"  {inside[1].rstrip()}")
        elif not line.startswith("╰"):
            lines.append(line.rstrip())
    return "```text\n" + re.sub(r"\n{3,}", "\n\n", "\n".join(lines)) + "\n```"
