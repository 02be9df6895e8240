"""`idf-slam bench-odometry`."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from idfslam.cli.commands.command import Values
from idfslam.config import FAST, check

if TYPE_CHECKING:
    from rich.console import Console


@dataclass(frozen=True)
class BenchOdometry:
    """The tracker alone, frame to keyframe: with and without finetuning, with and without the grid that spreads matches."""

    recordings: Positional[tuple[str, ...]]
    """Recordings with ground truth, of any layout, or synthetic[:SEED][:kinect]; PATH@FRAMES: the first FRAMES."""
    values: Values = FAST
    seeds: int = 3
    """How many seeds, from --seed on, where anything is random."""
    json: bool = False
    """One line of JSON instead of the table, the last of the output."""
    out: Path | None = None
    """A folder for odometry.json and odometry.md."""
    config: Path | None = None
    """A YAML file of values (a run's config.yaml, or a few lines of it); flags win over it, and it over the preset."""

    def __call__(self, console: "Console") -> None:
        values = check(self.values)
        import json

        from idfslam.benchmark.odometry import bench_odometry, markdown

        report = partial(console.print, highlight=False, markup=False, soft_wrap=True)
        found = bench_odometry(self.recordings, values, seeds=self.seeds, folder=self.out, report=report)
        print(json.dumps(found) if self.json else markdown(found))
