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
    """What this machine has, what a run would use of it, and what is missing; ends with 1 if something should be done."""

    values: Values = FAST
    out: Path = Path("results")
    """Folder that results would be written to."""
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
