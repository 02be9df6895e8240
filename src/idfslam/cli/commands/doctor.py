"""`idf-slam doctor`."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from idfslam.cli.commands.command import ConfigFile, Values, output
from idfslam.config import FAST, check

if TYPE_CHECKING:
    from rich.console import Console


@dataclass(frozen=True)
class Doctor:
    """Check this machine: what it has, what a run would use, and what is missing.

    It exits with status 1 if something needs fixing.
    """

    values: Values = FAST
    out: Path = Path("results")
    """Folder for results; its free disk space is checked."""
    json: bool = False
    """Print JSON instead of the table."""
    config: ConfigFile = None

    def __call__(self, console: "Console") -> None:
        values = check(self.values)
        from idfslam.cli.doctor import examine
        from idfslam.cli.tables import print_examination

        examination = examine(values, self.out)
        if self.json:
            print(json.dumps(asdict(examination) | {"ready": examination.ready}, indent=2))
        else:
            print_examination(examination, output())
        if not examination.ready:
            raise SystemExit(1)
