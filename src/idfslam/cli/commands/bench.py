"""`idf-slam bench`."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tyro.conf import Positional

from idfslam.cli.commands.command import ConfigFile, Values, output
from idfslam.cli.plain_text import plain_printer
from idfslam.config import FAST, check

if TYPE_CHECKING:
    from rich.console import Console


@dataclass(frozen=True)
class Bench:
    """Measure SLAM on recordings, with several seeds each.

    It reports mean and spread of errors, speed, memory and stage times.
    """

    recordings: Positional[tuple[str, ...]]
    """Recordings as for `run`. PATH@FRAMES uses the first FRAMES. A file gt_mesh.ply in a recording is its true surface."""
    values: Values = FAST
    seeds: int = 3
    """Number of seeds. The first is --seed."""
    frames: int | None = None
    """Number of frames of each recording. Default: all, or one tour of a generated recording."""
    against: tuple[str, ...] | None = None
    """Other systems to measure on the same frames, as far as they are installed: `open3d` (its dense SLAM), `orbslam3`, `rtabmap`, and
    `fusion` (plain TSDF fusion of our poses). NAME=PYTHON takes the Python of another environment. --out gets bench.html, a page that
    compares them."""
    out: Path | None = None
    """Folder of the results, with bench.json, bench.md and, with --against, bench.html. Default: results/bench, with a number if that
    exists."""
    overwrite: bool = False
    """Replace the results in --out, each when its run is complete."""
    mesh: bool = True
    """Evaluate the mesh if the true surface is known."""
    workers: int = 1
    """Number of seeds that run at the same time. With more than one, the measured speed is lower."""
    cluster: str | None = None
    """Address of a Ray cluster, or `auto`. Default: this machine."""
    config: ConfigFile = None

    def __call__(self, console: "Console") -> None:
        values = check(self.values)
        from idfslam.batch.open_executor import open_executor
        from idfslam.benchmark.peers.choice import PEERS
        from idfslam.benchmark.runs import PAGE, REPORT, TABLE, bench, check_finished
        from idfslam.cli.tables import print_files
        from idfslam.errors import ConfigError
        from idfslam.runs.run_folder import folder_for

        if self.against == ():
            raise ConfigError(f"--against: expected some of {', '.join(PEERS)} behind it")
        options: dict[str, Any] = {
            "seeds": self.seeds,
            "frames": self.frames,
            "mesh": self.mesh,
            "against": self.against or (),
            "overwrite": self.overwrite,
        }
        executor = open_executor(self.cluster, self.workers, jobs=self.seeds)
        report = plain_printer(console)
        folder = folder_for("bench", self.out, overwrite=self.overwrite)
        found = bench(self.recordings, values, folder, **options, report=report, executor=executor)
        print((folder / TABLE).read_text(encoding="utf-8"))
        if self.against:
            from idfslam.report.comparison_page import write_comparison

            write_comparison(folder, found)
        print_files(folder, (REPORT, TABLE, *((PAGE,) if self.against else ())), output())
        check_finished(found, folder)
