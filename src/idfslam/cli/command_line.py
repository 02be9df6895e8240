"""The command line: parses, then calls. What is heavy is imported inside the commands, so that --help is quick."""

import argparse
import os
import sys
from collections.abc import Sequence
from dataclasses import MISSING, fields
from functools import reduce
from operator import or_
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_args, get_type_hints

import tyro
from tyro.conf import DisallowNone, subcommand

from idfslam import __version__
from idfslam.cli.commands.batch import Batch
from idfslam.cli.commands.bench import Bench
from idfslam.cli.commands.bench_odometry import BenchOdometry
from idfslam.cli.commands.bench_pairs import BenchPairs
from idfslam.cli.commands.command import Command
from idfslam.cli.commands.demo import Demo
from idfslam.cli.commands.doctor import Doctor
from idfslam.cli.commands.download import Download
from idfslam.cli.commands.eval import Eval
from idfslam.cli.commands.export import Export
from idfslam.cli.commands.mesh import Mesh
from idfslam.cli.commands.pretrain import Pretrain
from idfslam.cli.commands.record import Record
from idfslam.cli.commands.render import Render
from idfslam.cli.commands.report import Report
from idfslam.cli.commands.run import Run
from idfslam.cli.commands.view import View
from idfslam.cli.user_options import HELP, HELP_ALL, parser_rules
from idfslam.compute.process import prepare_process
from idfslam.config import FAST, PRESETS, Config, load
from idfslam.errors import IdfSlamError
from idfslam.viewer.rerun_program import ViewerOption

if TYPE_CHECKING:
    from rich.console import Console

_INTERRUPTED = 130  # 128 + SIGINT, as shells have it


COMMANDS: dict[str, type] = {
    "demo": Demo,
    "run": Run,
    "record": Record,
    "eval": Eval,
    "mesh": Mesh,
    "export": Export,
    "render": Render,
    "batch": Batch,
    "report": Report,
    "view": View,
    "bench": Bench,
    "bench-pairs": BenchPairs,
    "bench-odometry": BenchOdometry,
    "pretrain": Pretrain,
    "download": Download,
    "doctor": Doctor,
}


def parse(arguments: Sequence[str]) -> Command:
    """The command with its flags. Exits with 0 after --help and with 2 on wrong usage.

    Raises ConfigError for a config file that cannot be used.
    """
    arguments = _with_viewer(arguments)
    values = _starting_values(arguments)
    commands: Any = reduce(or_, (_subcommand(name, command, values) for name, command in COMMANDS.items()))
    description = f"RGB-D SLAM with a neural tracker and a neural implicit map, version {__version__}."
    rules, args = parser_rules(arguments), [HELP[-1] if word == HELP_ALL else word for word in arguments]
    try:
        command: Command = tyro.cli(commands, prog="idf-slam", description=description, args=args, config=(DisallowNone,), registry=rules)
    except SystemExit as end:
        if not end.code and HELP_ALL not in arguments and hides_values(arguments[0]):
            print(f"These are the options that users set. All: idf-slam {arguments[0]} {HELP_ALL}, or the docs' page Configuration.")
        raise
    return command


def _subcommand(name: str, command: type, values: Config) -> Any:
    """A command as tyro takes it; where it takes a configuration, its flags start from `values`."""
    if get_type_hints(command).get("values") is not Config:
        return Annotated[command, subcommand(name)]
    required = {f.name: tyro.MISSING for f in fields(command) if f.default is MISSING and f.default_factory is MISSING}
    return Annotated[command, subcommand(name, default=command(values=values, **required))]


def hides_values(name: str) -> bool:
    """Whether the command of this name has flags that only --help-all shows: values of a configuration."""
    return name in COMMANDS and "values" in get_type_hints(COMMANDS[name])


def _starting_values(arguments: Sequence[str]) -> Config:
    """What the flags start from: the values of --config over those of --preset."""
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("--preset", nargs="?")
    parser.add_argument("--config", nargs="?", type=Path)
    options, _ = parser.parse_known_args(arguments)
    preset = options.preset if options.preset in PRESETS else None  # tyro reports an unknown one
    return load(options.config, base=preset) if options.config else PRESETS[preset or FAST.preset]


def _with_viewer(arguments: Sequence[str]) -> list[str]:
    """`--viewer` with no place behind it is `--viewer auto`."""
    bare = [i for i, word in enumerate(arguments) if word == "--viewer" and not set(arguments[i + 1 : i + 2]) & set(get_args(ViewerOption))]
    return [word for i, argument in enumerate(arguments) for word in ((argument, "auto") if i in bare else (argument,))]


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs a command; exits with 1 and one line on the user's mistakes, with 2 on wrong usage."""
    try:
        command = parse(sys.argv[1:] if arguments is None else arguments)
        prepare_process()
        command(_console())
    except IdfSlamError as error:
        print(f"error: {error}", file=sys.stderr)
        raise SystemExit(1) from None
    except BrokenPipeError:  # whoever read the output has gone, as `head` does
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # or Python would fail once more when it flushes at its end
        raise SystemExit(1) from None
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        raise SystemExit(_INTERRUPTED) from None


def _console() -> "Console":
    """Where progress and warnings go: stderr."""
    import logging

    from rich.console import Console
    from rich.logging import RichHandler

    console = Console(stderr=True)
    handler = RichHandler(console=console, show_time=False, show_path=False, markup=False)
    logging.basicConfig(level=logging.WARNING, handlers=[handler], format="%(message)s", force=True)
    logging.getLogger("idfslam").setLevel(logging.INFO)  # loops closed, a lost camera found
    return console
