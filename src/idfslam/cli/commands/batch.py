"""`idf-slam batch`."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from idfslam.cli.commands.command import ConfigFile, Values, output
from idfslam.cli.plain_text import plain_printer
from idfslam.config import FAST, check

if TYPE_CHECKING:
    from rich.console import Console


@dataclass(frozen=True)
class Batch:
    """Run SLAM on many recordings, several at once.

    It runs on this machine or on a Ray cluster, writes a result folder for each recording, and prints a table of all.
    """

    recordings: Positional[tuple[str, ...]]
    """Recordings, or lists of recordings. PATH@FRAMES uses the first FRAMES. A list is a .yaml file, or a .txt file with one recording a
    line, followed by options of `run` (`/data/office frames=500 camera.fx=525`)."""
    values: Values = FAST
    out: Path | None = None
    """Folder of the results: a folder for each recording, and batch.json. Default: results/batch, with a number if that exists."""
    overwrite: bool = False
    """Replace the results in --out, each when its run is complete."""
    workers: int | None = None
    """Number of runs at the same time. They share the cores equally. Default: one per core, as far as memory allows."""
    cluster: str | None = None
    """Address of a Ray cluster. `auto` takes the cluster of this machine, or its own cores. Default: processes of this machine."""
    gpus: float = 0.0
    """GPUs for each run on the cluster. With a fraction, several runs share a GPU."""
    retries: int = 2
    """Number of restarts of a run whose process was killed. Failed nodes of a cluster are not counted."""
    config: ConfigFile = None

    def __call__(self, console: "Console") -> None:
        values = check(self.values)
        from idfslam.batch.batch import batch, check_done
        from idfslam.batch.batch_file import read_batch
        from idfslam.batch.open_executor import open_executor
        from idfslam.cli.tables import print_batch
        from idfslam.runs.run_folder import folder_for

        items = read_batch(self.recordings, values)
        report = plain_printer(console)
        with open_executor(self.cluster, self.workers, jobs=len(items), gpus=self.gpus, retries=self.retries) as executor:
            folder = folder_for("batch", self.out, overwrite=self.overwrite)
            rows = batch(items, values, folder, executor, overwrite=self.overwrite, report=report)
        print_batch(rows, folder, output())
        check_done(rows, folder)
