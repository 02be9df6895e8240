"""`idf-slam demo`."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from idfslam.cli.commands.command import ConfigFile, Values, output
from idfslam.config import FAST, check
from idfslam.errors import ConfigError

if TYPE_CHECKING:
    from rich.console import Console


@dataclass(frozen=True)
class Demo:
    """Run SLAM on a generated room, evaluate it and draw pictures. It needs no files."""

    values: Values = FAST
    out: Path | None = None
    """Result folder; it must be new or empty. Default: results/demo, with a number if that exists."""
    overwrite: bool = False
    """Replace the results in --out; they stay until the new ones are complete."""
    frames: int = 240
    """Number of frames."""
    room: int = 0
    """Seed of the generated room."""
    report: bool = True
    """Write report.html with its pictures at the end."""
    config: ConfigFile = None

    def __call__(self, console: "Console") -> None:
        values = check(self.values)
        if self.room < 0 or self.frames < 1:  # known before a folder is made
            raise ConfigError(f"--room {self.room} --frames {self.frames}, expected a seed of at least 0 and at least 1 frame")
        from idfslam.cli.tables import print_evaluation, print_files, print_run
        from idfslam.compute.torch_threads import limit_torch_threads
        from idfslam.demo.demo import demo
        from idfslam.runs.run_folder import check_usable, folder_for

        limit_torch_threads(values.field.encoding)
        folder = folder_for("demo", self.out, overwrite=self.overwrite)
        check_usable(folder, overwrite=self.overwrite, report=self.report)
        options: dict[str, Any] = {"report": self.report, "overwrite": self.overwrite, "console": console}
        done, evaluation, pictures = demo(values, folder, room=self.room, frames=self.frames, **options)
        print_run(done, output())
        print_evaluation(evaluation, folder, output())
        print_files(folder, [path.name for path in pictures], output())
