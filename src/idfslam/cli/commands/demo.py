"""`idf-slam demo`."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from idfslam.cli.commands.command import ConfigFile, Values, output
from idfslam.config import FAST, check

if TYPE_CHECKING:
    from rich.console import Console


@dataclass(frozen=True)
class Demo:
    """SLAM on a room that the package generates itself: run, evaluation and pictures, no files needed."""

    values: Values = FAST
    out: Path = Path("results/demo")
    """Result folder."""
    frames: int = 240
    """Number of frames of the walk through the room."""
    room: int = 0
    """Seed of the generated room."""
    report: bool = True
    """Write report.html with its pictures at the end."""
    config: ConfigFile = None

    def __call__(self, console: "Console") -> None:
        values = check(self.values)
        from idfslam.cli.tables import print_evaluation, print_files, print_run
        from idfslam.compute.torch_threads import limit_torch_threads
        from idfslam.demo.demo import demo

        limit_torch_threads(values.field.encoding)
        done, evaluation, pictures = demo(values, self.out, room=self.room, frames=self.frames, report=self.report, console=console)
        print_run(done, output())
        print_evaluation(evaluation, self.out, output())
        print_files(self.out, [path.name for path in pictures], output())
