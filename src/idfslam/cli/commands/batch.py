"""`idf-slam batch`."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from idfslam.cli.commands.command import Values, output
from idfslam.config import FAST, check

if TYPE_CHECKING:
    from rich.console import Console


@dataclass(frozen=True)
class Batch:
    """SLAM on many recordings, several at once, on this machine or a Ray cluster: a result folder each, and a table of all."""

    recordings: Positional[tuple[str, ...]]
    """Recordings (or synthetic[:SEED][:kinect]; PATH@FRAMES: the first FRAMES), or lists of such: .txt, a recording a line with what `run`
    takes behind it (`/data/office frames=500 camera.fx=525`), or .yaml."""
    values: Values = FAST
    out: Path = Path("results/batch")
    """Where a folder for each recording goes, and batch.json."""
    workers: int | None = None
    """How many runs at once; none given: one a core, as far as memory goes. Each run gets its share of the cores."""
    cluster: str | None = None
    """Run on Ray: `auto` (the cluster that this machine is in, or its own cores) or an address; none given: processes of this machine."""
    gpus: float = 0.0
    """GPUs of the cluster that each run gets; a fraction: several runs share one."""
    retries: int = 2
    """How often a run whose process was killed is started again."""
    config: Path | None = None
    """A YAML file of values (a run's config.yaml, or a few lines of it); flags win over it, and it over the preset."""

    def __call__(self, console: "Console") -> None:
        values = check(self.values)
        from idfslam.batch.batch import batch, check_done
        from idfslam.batch.batch_file import read_batch
        from idfslam.batch.open_executor import open_executor
        from idfslam.cli.tables import print_batch

        items = read_batch(self.recordings, values)
        report = partial(console.print, highlight=False, markup=False, soft_wrap=True)
        with open_executor(self.cluster, self.workers, jobs=len(items), gpus=self.gpus, retries=self.retries) as executor:
            rows = batch(items, values, self.out, executor, report=report)
        print_batch(rows, self.out, output())
        check_done(rows, self.out)
