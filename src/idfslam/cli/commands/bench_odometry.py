"""`idf-slam bench-odometry`."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from idfslam.cli.commands.command import ConfigFile, Values
from idfslam.cli.plain_text import plain_printer
from idfslam.config import FAST, check

if TYPE_CHECKING:
    from rich.console import Console


@dataclass(frozen=True)
class BenchOdometry:
    """Measure the tracker alone, from frame to keyframe.

    It is measured with and without finetuning, and with and without the grid that spreads matches.
    """

    recordings: Positional[tuple[str, ...]]
    """Recordings with ground truth, as for `run`. PATH@FRAMES uses the first FRAMES."""
    values: Values = FAST
    seeds: int = 3
    """Number of seeds, where anything is random. The first is --seed."""
    json: bool = False
    """Print one line of JSON as the last line, instead of the table."""
    out: Path | None = None
    """Folder for odometry.json and odometry.md. Default: no files are written."""
    config: ConfigFile = None

    def __call__(self, console: "Console") -> None:
        values = check(self.values)
        import json

        from idfslam.benchmark.odometry import bench_odometry, markdown
        from idfslam.compute.torch_threads import limit_torch_threads

        limit_torch_threads(values.field.encoding)
        report = plain_printer(console)
        found = bench_odometry(self.recordings, values, seeds=self.seeds, folder=self.out, report=report)
        print(json.dumps(found) if self.json else markdown(found))
