"""`idf-slam report`."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

if TYPE_CHECKING:
    from rich.console import Console


@dataclass(frozen=True)
class Report:
    """A run as a page to look at: report.html, one file that needs no other, and its pictures."""

    folder: Positional[Path]
    """Result folder."""
    gt: Path | None = None
    """True trajectory, camera-to-world, in any form that `eval` takes; none given: the recording's own, where it has one."""
    recording: Path | None = None
    """New path of the recording, if it was moved after the run."""

    def __call__(self, console: "Console") -> None:
        from idfslam.report.writing import write_report

        print(write_report(self.folder, moved=self.recording, gt=self.gt)[0])
