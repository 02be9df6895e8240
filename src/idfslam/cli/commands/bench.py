"""`idf-slam bench`."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from tyro.conf import Positional

from idfslam.cli.commands.command import Values, output
from idfslam.config import FAST, check

if TYPE_CHECKING:
    from rich.console import Console


@dataclass(frozen=True)
class Bench:
    """SLAM on a list of recordings with several seeds each: mean and spread of errors, speed, memory and stage times."""

    recordings: Positional[tuple[str, ...]]
    """Recordings as `run` takes them; PATH@FRAMES: the first FRAMES. gt_mesh.ply in one is its true surface."""
    values: Values = FAST
    seeds: int = 3
    """How many seeds, from --seed on."""
    frames: int | None = None
    """How many frames of each; none given: all of a recording, one tour of a generated one."""
    against: Literal["open3d"] | None = None
    """A baseline on the same frames: Open3D's dense frame-to-model SLAM, on the CPU."""
    out: Path = Path("results/bench")
    """Where results, bench.json and bench.md go."""
    mesh: bool = True
    """Whether the surface is evaluated where the true one is known."""
    workers: int = 1
    """Seeds of a recording that run at once; more than one disturb each other's speed."""
    cluster: str | None = None
    """Run on Ray: `auto` or the address of a cluster; none given: on this machine."""
    config: Path | None = None
    """A YAML file of values (a run's config.yaml, or a few lines of it); flags win over it, and it over the preset."""

    def __call__(self, console: "Console") -> None:
        values = check(self.values)
        from idfslam.batch.open_executor import open_executor
        from idfslam.benchmark.runs import REPORT, TABLE, bench, check_finished
        from idfslam.cli.tables import print_files

        options: dict[str, Any] = {"seeds": self.seeds, "frames": self.frames, "mesh": self.mesh, "against": self.against}
        executor = open_executor(self.cluster, self.workers, jobs=self.seeds)
        report = partial(console.print, highlight=False, markup=False, soft_wrap=True)
        found = bench(self.recordings, values, self.out, **options, report=report, executor=executor)
        print((self.out / TABLE).read_text(encoding="utf-8"))
        print_files(self.out, (REPORT, TABLE), output())
        check_finished(found, self.out)
