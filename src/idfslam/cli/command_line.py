"""The command line: parses, then calls. What is heavy is imported inside the commands, so that --help is quick."""

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

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
from idfslam.compute.process import prepare_process
from idfslam.config import FAST, PRESETS, Config, load
from idfslam.errors import IdfSlamError

if TYPE_CHECKING:
    from rich.console import Console

_INTERRUPTED = 130  # 128 + SIGINT, as shells have it


def parse(arguments: Sequence[str]) -> Command:
    """The command with its flags. Raises ConfigError for a config file that cannot be used; exits with 2 on wrong usage."""
    arguments = _with_viewer(arguments)
    values = _starting_values(arguments)
    commands: Any = (
        Annotated[Demo, subcommand("demo", default=Demo(values))]
        | Annotated[Run, subcommand("run", default=Run(values=values))]
        | Annotated[Record, subcommand("record")]
        | Annotated[Eval, subcommand("eval")]
        | Annotated[Mesh, subcommand("mesh")]
        | Annotated[Export, subcommand("export")]
        | Annotated[Render, subcommand("render")]
        | Annotated[Batch, subcommand("batch", default=Batch(tyro.MISSING, values))]
        | Annotated[Report, subcommand("report")]
        | Annotated[View, subcommand("view")]
        | Annotated[Bench, subcommand("bench", default=Bench(tyro.MISSING, values))]
        | Annotated[BenchPairs, subcommand("bench-pairs", default=BenchPairs(tyro.MISSING, values))]
        | Annotated[BenchOdometry, subcommand("bench-odometry", default=BenchOdometry(tyro.MISSING, values))]
        | Annotated[Pretrain, subcommand("pretrain")]
        | Annotated[Download, subcommand("download")]
        | Annotated[Doctor, subcommand("doctor", default=Doctor(values))]
    )
    description = f"RGB-D SLAM with a neural tracker and a neural implicit map, version {__version__}."
    command: Command = tyro.cli(commands, prog="idf-slam", description=description, args=list(arguments), config=(DisallowNone,))
    return command


def _starting_values(arguments: Sequence[str]) -> Config:
    """What the flags start from: the values of --config over those of --preset."""
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("--preset", nargs="?")
    parser.add_argument("--config", nargs="?", type=Path)
    found, _ = parser.parse_known_args(arguments)
    preset = found.preset if found.preset in PRESETS else None  # the parser proper complains of another one
    return load(found.config, base=preset) if found.config else PRESETS[preset or FAST.preset]


def _with_viewer(arguments: Sequence[str]) -> list[str]:
    """`--viewer` with no place behind it is `--viewer auto`."""
    places = ("none", "auto", "window", "web", "file")
    bare = [i for i, word in enumerate(arguments) if word == "--viewer" and arguments[i + 1 : i + 2] not in [[place] for place in places]]
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
