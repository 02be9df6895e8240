"""`idf-slam report`."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

if TYPE_CHECKING:
    from rich.console import Console


@dataclass(frozen=True)
class Report:
    """Write the report of a run: report.html, a page in one file, and its pictures."""

    folder: Positional[Path]
    """Result folder."""
    gt: Path | None = None
    """True trajectory, camera-to-world, in any form that `eval` takes. Default: the recording's own, if it has one."""
    recording: Path | None = None
    """New path of the recording, if it was moved after the run."""

    def __call__(self, console: "Console") -> None:
        from idfslam.report.writing import write_report

        print(write_report(self.folder, moved=self.recording, gt=self.gt)[0])
