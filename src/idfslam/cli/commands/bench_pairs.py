"""`idf-slam bench-pairs`."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tyro.conf import Positional

from idfslam.cli.commands.command import Values
from idfslam.config import FAST, check

if TYPE_CHECKING:
    from rich.console import Console


@dataclass(frozen=True)
class BenchPairs:
    """Relative poses of frames some frames apart: the tracker against SIFT, ORB, ICP, GICP and untrained features."""

    recordings: Positional[tuple[str, ...]]
    """Recordings with ground truth, as `run` takes them; PATH@FRAMES: the first FRAMES."""
    values: Values = FAST
    gap: tuple[int, ...] = (5, 10, 20, 40)
    """How many frames apart; several give a block of rows each."""
    pairs: int = 100
    """Pairs of each recording and gap, spread over it."""
    weights: tuple[Path, ...] = ()
    """Further weights of `idf-slam pretrain`, a row each."""
    baselines: bool = True
    """Whether untrained features, SIFT, ORB, ICP and GICP are measured beside."""
    json: bool = False
    """One line of JSON instead of the table, the last of the output."""
    out: Path | None = None
    """A folder for pairs.json, pairs.md and pictures of matches."""
    config: Path | None = None
    """A YAML file of values (a run's config.yaml, or a few lines of it); flags win over it, and it over the preset."""

    def __call__(self, console: "Console") -> None:
        values = check(self.values)
        import json

        from idfslam.benchmark.pairs import bench_pairs, markdown

        report = partial(console.print, highlight=False, markup=False, soft_wrap=True)
        options: dict[str, Any] = {"gaps": self.gap, "pairs": self.pairs, "weights": self.weights, "folder": self.out}
        options["against_baselines"] = self.baselines
        found = bench_pairs(self.recordings, values, **options, report=report)
        print(json.dumps(found) if self.json else markdown(found))
