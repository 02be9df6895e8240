"""What every command of the command line has."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Protocol

from tyro.conf import arg

from idfslam.config import Config

if TYPE_CHECKING:
    from rich.console import Console

NARROWEST = 60  # [columns] help and tables for a narrower terminal are laid out for this many; fewer: columns of single letters
Values = Annotated[Config, arg(name="")]  # its fields are flags of their own: --seed, --mapper.pixels
ConfigFile = Annotated[
    Path | None,
    arg(
        help="YAML file of values, such as a run's config.yaml. They replace those of the preset. Options replace both.",
        help_behavior_hint="",
    ),
]


class Command(Protocol):
    """A command with its flags; the console takes progress and warnings."""

    def __call__(self, console: "Console") -> None: ...


def output() -> "Console":
    """Where figures and paths go: stdout."""
    from rich.console import Console

    console = Console()
    console.width = max(console.width, NARROWEST)
    return console
