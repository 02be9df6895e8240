"""`idf-slam doctor`."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from idfslam.cli.commands.command import Values, output
from idfslam.config import FAST, check

if TYPE_CHECKING:
    from rich.console import Console


@dataclass(frozen=True)
class Doctor:
    """What this machine has, what a run would use of it, and what is missing; ends with 1 if something should be done."""

    values: Values = FAST
    out: Path = Path("results")
    """Where results would go."""
    json: bool = False
    """All of it as JSON."""
    config: Path | None = None
    """A YAML file of values (a run's config.yaml, or a few lines of it); flags win over it, and it over the preset."""

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
