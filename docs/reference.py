"""The pages that are generated when the site is built: every configuration value, every constant, and every command's --help."""

import inspect
import io
import os
import re
import sys
from contextlib import redirect_stdout
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

import idfslam
from idfslam.cli import command_line
from idfslam.cli.command_line import hides_values
from idfslam.cli.user_options import HELP_ALL
from idfslam.config import FAST, PAPER, PRETRAIN, PretrainConfig
from idfslam.config.fields import field_types, is_user_option, meanings

sys.path.insert(0, str(Path(__file__).parent))
import constants

PACKAGE = Path(str(idfslam.__file__)).parent
_WIDTH = 96  # columns of the help texts
_MARK = "★"  # of values that users set
_SECTIONS = tuple(f.name for f in fields(FAST) if is_dataclass(getattr(FAST, f.name)))


def on_files(files: Files, config: MkDocsConfig, **_: Any) -> Files:
    """Adds the generated pages."""
    for name, text in {"configuration": configuration(), "constants": constants.page(PACKAGE), "commands": commands()}.items():
        files.append(File.generated(config, f"reference/{name}.md", content=text))
    return files


def configuration() -> str:
    """Every value: its flag, the two presets, what it means."""
    parts = [
        "# Configuration",
        "Every value is a flag of `demo`, `run`, `batch` and the `bench` commands (`--mapper.pixels 256`, `--mapper.no-active-sampling`) "
        "and a key of a YAML file for `--config` (a run's `config.yaml` is one). Flags replace the values of the file, and these replace "
        "those of `--preset`. `paper` holds the values of the paper's Sec. VI-A; where its column is empty, both presets agree.",
        f"Values that users set are marked {_MARK}: `--help` shows them alone, and `--help-all` shows every value.",
        "## The run as a whole",
        _table("", FAST, PAPER),
    ]
    for section in _SECTIONS:
        values = getattr(FAST, section)
        parts += [f"## {section}", str(inspect.getdoc(type(values))), _table(f"{section}.", values, getattr(PAPER, section))]
    parts += ["## Flags of pretrain", str(inspect.getdoc(PretrainConfig)), _table("", PRETRAIN, PRETRAIN)]
    return "\n\n".join(parts) + "\n"


def _table(prefix: str, fast: Any, paper: Any) -> str:
    two = paper is not fast
    rows = ["| value | default |" + (" paper |" if two else "") + " meaning |", "|---|---|" + ("---|" if two else "") + "---|"]
    types = field_types(type(fast))
    for name, meaning in meanings(type(fast)).items():
        ours, theirs = getattr(fast, name), getattr(paper, name)
        flag = f"`{prefix}{name}`" + (f" {_MARK}" if is_user_option(types[name]) else "")
        cells = [flag, f"`{ours}`", *([f"`{theirs}`" if theirs != ours else ""] if two else []), meaning.replace("|", "\\|")]
        rows.append("| " + " | ".join(cells) + " |")
    return "\n".join(rows)


def commands() -> str:
    """Every command's --help, without the sections of the configuration, which has a page of its own."""
    parts = ["# Command line", _block(_help())]
    for name in command_line.COMMANDS:
        parts += [f"## idf-slam {name}", _block(_without_sections(_help(name)))]
        if hides_values(name):
            parts.append("And every value of the [configuration](configuration.md).")
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


def _without_sections(text: str) -> str:
    """The help without the boxes of configuration sections, and without its last line, which names --help-all."""
    boxes = re.split(r"(?m)^(?=╭─ )", "".join(line for line in text.splitlines(keepends=True) if HELP_ALL not in line))
    return "".join(box for box in boxes if not re.match(rf"╭─ ({'|'.join(_SECTIONS)}) options", box))


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
