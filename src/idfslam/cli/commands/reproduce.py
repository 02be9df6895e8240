"""`idf-slam reproduce`."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from idfslam.cli.commands.command import output
from idfslam.cli.plain_text import plain_printer

if TYPE_CHECKING:
    from rich.console import Console


@dataclass(frozen=True)
class Reproduce:
    """Reproduce the paper's tables and figures, with what it prints beside what is measured.

    Finished rows are kept: an interrupted call goes on where it was. At the paper's own sizes a sequence of 2000 frames takes hours on a
    GPU (7 in the paper); --small is for a CPU.
    """

    small: bool = False
    """Generated rooms alone, and reduced sizes of all methods."""
    data: Path = Path("data")
    """Folder of recordings: Replica/ as `idf-slam download replica` makes it, scannet/sceneNNNN_NN. Generated rooms stand in for what is
    not there."""
    methods: tuple[str, ...] | None = None
    """Presets to compare. Default: all."""
    ablations: bool = True
    """Run the paper's preset with one part left out at a time, too."""
    seed: int = 0
    """Seed of every random choice."""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """Device of all runs."""
    out: Path = Path("results/reproduce")
    """Folder of the results: a folder for each run, reproduce.json, reproduce.md and the page reproduce.html."""
    overwrite: bool = False
    """Make all rows anew."""
    workers: int | None = None
    """Number of runs at the same time. Default: one per core, as far as memory allows; with a GPU, one."""
    cluster: str | None = None
    """Address of a Ray cluster, or `auto`. Default: this machine."""
    gpus: float = 0.0
    """GPUs for each run on the cluster."""

    def __call__(self, console: "Console") -> None:
        from idfslam.batch.open_executor import open_executor
        from idfslam.benchmark.reproduction.matches import draw_grid_matches
        from idfslam.benchmark.reproduction.rows import check_rows, run_suite
        from idfslam.benchmark.reproduction.suite import full_suite, methods_of, small_suite
        from idfslam.cli.tables import print_files
        from idfslam.compute.devices import resolve_device
        from idfslam.errors import ConfigError
        from idfslam.report.reproduction_page import MATCHES, PAGE, TABLE, write_reproduction

        methods = methods_of(self.methods)
        if self.small and self.data != Reproduce.data:
            raise ConfigError(f"--data {self.data} with --small, which takes generated rooms alone: leave one of the two out")
        if self.data != Reproduce.data and not self.data.is_dir():
            raise ConfigError(
                f"--data {self.data}: no such folder, expected one that holds Replica/ or scannet/; leave it out for generated rooms"
            )
        suite = small_suite(methods, ablations=self.ablations) if self.small else full_suite(self.data, methods, ablations=self.ablations)
        on_gpu = self.cluster is None and resolve_device(self.device, "paper").type == "cuda"
        workers = 1 if on_gpu and self.workers is None else self.workers
        report = plain_printer(console)
        with open_executor(self.cluster, workers, jobs=len(suite.jobs), gpus=self.gpus) as executor:
            found = run_suite(suite, self.out, executor, seed=self.seed, device=self.device, overwrite=self.overwrite, report=report)
        draw_grid_matches(suite, self.out)
        write_reproduction(self.out, found, total=len(suite.jobs))
        print((self.out / TABLE).read_text(encoding="utf-8"))
        print_files(self.out, [name for name in (TABLE, PAGE, MATCHES) if (self.out / name).is_file()], output())
        check_rows(found, suite, self.out)
