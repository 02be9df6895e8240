"""The overview of all commands, and wrong usage in one line with the nearest name."""

import platform
import re
import sys
from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from importlib.metadata import PackageNotFoundError, version
from typing import NoReturn

from idfslam import __version__
from idfslam.errors import IdfSlamError

WRONG_USAGE = 2  # exit status
COMMON = {
    "-h, --help": "show this help; after a command, the help of that command",
    "-q, --quiet": "show warnings, errors and results only, no progress",
    "-v, --verbose": "show details, and the traceback of an error",
    "--version": "show the versions of idf-slam, Python, torch and Numba",
}
"""Options of every command, before or after its name."""


def version_line() -> str:
    """The versions of idf-slam and of what decides how it computes, in one line."""
    return f"idf-slam {__version__}, Python {platform.python_version()}, torch {_version('torch')}, Numba {_version('numba')}"


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "missing"


def overview(commands: Mapping[str, type]) -> str:
    """All commands with their first sentences, and the options that every command has."""
    lines = ["usage: idf-slam COMMAND [OPTIONS]", "", f"RGB-D SLAM with a neural tracker and a neural implicit map, version {__version__}."]
    lines += ["", "commands:", *(f"  {name:15} {first_sentence(command)}" for name, command in commands.items())]
    lines += ["", "options of every command:", *(f"  {flags:15} {text}" for flags, text in COMMON.items())]
    return "\n".join(lines)


def first_sentence(command: type) -> str:
    """The first sentence of a command's docstring, without its full stop."""
    return " ".join((command.__doc__ or "").split("\n\n")[0].split()).split(". ")[0].removesuffix(".")


def wrong_usage(message: str, command: str = "") -> NoReturn:
    """Prints what is wrong and where help is. Raises SystemExit."""
    where = f"idf-slam {command}".rstrip()
    print(f"error: {IdfSlamError(message)} (help: {where} --help)", file=sys.stderr)  # such an error shortens what is very long
    raise SystemExit(WRONG_USAGE)


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """A question about the nearest known name; empty if none is near."""
    near = get_close_matches(word, list(known), n=1, cutoff=0.6)
    return f", did you mean {near[0]}?" if near else ""


def condensed(box: str) -> str:
    """An error message of tyro, which is a box of several lines, as one sentence."""
    words = " ".join(re.sub(r"[│╭╮╰╯─|]|-{5,}", " ", box).split())
    words = re.split(r"\s*(For full helptext|Argument helptext)", words)[0]
    if value := re.search(r"Error parsing (\S+): .*?type matching (.+?) could be instantiated from (\[.*?\])\.", words):
        return f"{value[1]}: found {value[3].strip('[]')}, expected {value[2]}"
    if number := re.search(r"Error parsing (\S+): invalid literal for int\(\) with base 10: (.+)", words):
        return f"{number[1]}: found {number[2]}, expected INT"
    if digits := re.search(r"Error parsing (\S+): Exceeds the limit", words):
        return f"{digits[1]}: found a number of thousands of digits, expected INT"
    if choice := re.search(r"invalid choice (.+?) for argument '(\S+)'\. Expected one of \((.*?),?\)", words):
        return f"{choice[2]}: found {choice[1]}, expected one of {_choices(choice[3])}".replace("'", "")
    if lacking := re.search(r"Missing value for argument '(\S+?)(?:/\S+)?'\. Expected", words):
        return f"{lacking[1]}: expected a value behind it"
    if missing := re.search(r"Missing from [\w -]+?: (.+)", words):
        return f"missing: {missing[1].removesuffix('(required)').strip()}".removesuffix(".")
    return words.removesuffix(".")


def _choices(names: str) -> str:
    """tyro's list of choices. One with None is a set, in any order, and None is what leaving the option out means."""
    words = names.replace("'", "").split(", ")
    return names if "None" not in words else ", ".join(sorted(word for word in words if word != "None"))
