"""The command line: parses, then calls. What is heavy is imported inside the commands, so that --help is quick."""

import argparse
import io
import logging
import os
import re
import shutil
import sys
from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout, suppress
from dataclasses import MISSING, fields
from functools import reduce
from operator import or_
from pathlib import Path
from typing import Annotated, Any, NoReturn, get_args, get_type_hints

import tyro
from tyro.conf import DisallowNone, subcommand

from idfslam.cli.commands.batch import Batch
from idfslam.cli.commands.bench import Bench
from idfslam.cli.commands.bench_odometry import BenchOdometry
from idfslam.cli.commands.bench_pairs import BenchPairs
from idfslam.cli.commands.calibrate import Calibrate
from idfslam.cli.commands.command import NARROWEST, Command
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
from idfslam.cli.commands.reproduce import Reproduce
from idfslam.cli.commands.run import Run
from idfslam.cli.commands.view import View
from idfslam.cli.failure import one_line_errors
from idfslam.cli.streams import prepare_streams
from idfslam.cli.usage import COMMON, WRONG_USAGE, condensed, did_you_mean, overview, version_line, wrong_usage
from idfslam.cli.user_options import HELP, HELP_ALL, parser_rules
from idfslam.cli.verbosity import Verbosity, open_console, take_verbosity
from idfslam.compute.cache_folder import prepare_caches
from idfslam.compute.process import prepare_process
from idfslam.config import FAST, PRESETS, Config, load
from idfslam.viewer.rerun_program import ViewerOption

log = logging.getLogger(__name__)


COMMANDS: dict[str, type] = {
    "demo": Demo,
    "run": Run,
    "record": Record,
    "calibrate": Calibrate,
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
    "reproduce": Reproduce,
    "pretrain": Pretrain,
    "download": Download,
    "doctor": Doctor,
}


def parse(arguments: Sequence[str]) -> Command:
    """The command with its flags. Exits with 0 after --help and with 2 on wrong usage.

    Raises ConfigError for a config file that cannot be used.
    """
    name = arguments[0] if arguments else ""
    if name not in COMMANDS:
        _without_command(name)
    if "" in arguments:  # as a path it would be the current folder
        before = arguments[list(arguments).index("") - 1]
        wrong_usage(f"the word behind {before} is empty, expected a value: a shell variable may be unset", name)
    arguments = [_with_home(word) for word in _with_viewer(arguments)]
    asks_help = HELP_ALL in arguments or any(flag in arguments for flag in HELP)
    values = _starting_values(arguments)
    if asks_help:
        _show_help(name, arguments, values)
    problem = io.StringIO()
    try:
        with redirect_stderr(problem):
            command, unknown = _parsed(arguments, values)
    except SystemExit:
        if misspelt := _unknown_options(arguments, values):  # what tyro says of the rest would be a riddle
            _refuse(misspelt[0], name, values)
        wrong_usage(condensed(problem.getvalue()), name)
    if unknown:
        _refuse(unknown[0], name, values)
    return command


def _without_command(first: str) -> NoReturn:
    """Ends the program if its first word is no command: with the overview, or with what is wrong."""
    if first in (*HELP, HELP_ALL, "help"):
        print(overview(COMMANDS))
        raise SystemExit(0)
    if not first:
        print(overview(COMMANDS), file=sys.stderr)
        raise SystemExit(WRONG_USAGE)
    kind = "option" if first.startswith("-") else "command"
    known = [word for words in COMMON for word in words.split(", ")] if kind == "option" else list(COMMANDS)
    wrong_usage(f"unknown {kind} {first}{did_you_mean(first, known)}")


def _parsed(arguments: Sequence[str], values: Config) -> tuple[Command, list[str]]:
    """The command, and the words that belong to none of its options. tyro's own errors end the program with a box on stderr."""
    commands: Any = reduce(or_, (_subcommand(name, command, values) for name, command in COMMANDS.items()))
    args = [HELP[-1] if word == HELP_ALL else word for word in arguments]
    rules = parser_rules(arguments)
    return tyro.cli(commands, prog="idf-slam", args=args, config=(DisallowNone,), registry=rules, return_unknown_args=True)


def _show_help(name: str, arguments: Sequence[str], values: Config) -> None:
    """Prints the help of a command. Always exits."""
    if shutil.get_terminal_size().columns < NARROWEST:
        os.environ["COLUMNS"] = str(NARROWEST)
    with suppress(SystemExit):
        _parsed(arguments, values)
    print("\n".join(f"{flags:15} {text}" for flags, text in COMMON.items() if HELP[-1] not in flags))
    if HELP_ALL not in arguments and hides_values(name):
        print(f"These are the options that users set. All: idf-slam {name} {HELP_ALL}, or the docs' page Configuration.")
    raise SystemExit(0)


def _refuse(word: str, name: str, values: Config) -> None:
    """Ends the program because of a word that is no option of the command, with the nearest option."""
    if not word.startswith("-"):
        wrong_usage(f"unexpected argument {word!r}", name)
    option = word.partition("=")[0]
    wrong_usage(f"unknown option {option}{did_you_mean(option, _options(name, values))}", name)


def _unknown_options(arguments: Sequence[str], values: Config) -> list[str]:
    """Those of the words that look like options and are none of the command, its name being the first word."""
    known = _options(arguments[0], values)
    return [word for word in arguments[1:] if word.startswith("--") and word.partition("=")[0].replace("_", "-") not in known]


def _options(name: str, values: Config) -> list[str]:
    """The long options of a command, as its help lists them."""
    shown = io.StringIO()
    with redirect_stdout(shown), suppress(SystemExit):
        _parsed([name, HELP_ALL], values)
    return re.findall(r"--[a-z][a-z0-9.-]+", shown.getvalue())


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


def _with_home(word: str) -> str:
    """A word with the user's folder in the place of `~`, which shells leave as it is in --out=~/results, and Windows everywhere."""
    option, equals, value = word.partition("=") if word.startswith("--") else ("", "", word)
    return option + equals + os.path.expanduser(value)


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs a command; exits with 1 and one line on errors, with 2 on wrong usage."""
    prepare_streams()
    words, verbosity = take_verbosity(sys.argv[1:] if arguments is None else arguments)
    with one_line_errors(verbose=verbosity is Verbosity.VERBOSE):
        if "--version" in words:
            print(version_line())
            return
        command = parse(words)
        prepare_process()
        console = open_console(verbosity)
        log.debug("%s; kernels are kept in %s", version_line(), prepare_caches().folder)
        command(console)
