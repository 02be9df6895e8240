"""`idf-slam bench-pairs`."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tyro.conf import Positional

from idfslam.cli.commands.command import ConfigFile, Values
from idfslam.cli.plain_text import plain_printer
from idfslam.config import FAST, check

if TYPE_CHECKING:
    from rich.console import Console


@dataclass(frozen=True)
class BenchPairs:
    """Measure the tracker on pairs of frames, against SIFT, ORB, ICP, GICP and untrained features."""

    recordings: Positional[tuple[str, ...]]
    """Recordings with ground truth, as for `run`. PATH@FRAMES uses the first FRAMES."""
    values: Values = FAST
    gap: tuple[int, ...] = (5, 10, 20, 40)
    """Distances between the frames of a pair, in frames. Each gives a block of rows."""
    pairs: int = 100
    """Number of pairs for each recording and gap, spread over the recording."""
    weights: tuple[Path, ...] = ()
    """Files of further weights from `idf-slam pretrain`. Each gives a row."""
    baselines: bool = True
    """Measure untrained features, SIFT, ORB, ICP and GICP too."""
    json: bool = False
    """Print one line of JSON as the last line, instead of the table."""
    out: Path | None = None
    """Folder for pairs.json, pairs.md and pictures of matches. Default: no files are written."""
    config: ConfigFile = None

    def __call__(self, console: "Console") -> None:
        values = check(self.values)
        import json

        from idfslam.benchmark.pairs import bench_pairs, markdown

        report = plain_printer(console)
        options: dict[str, Any] = {"gaps": self.gap, "pairs": self.pairs, "weights": self.weights, "folder": self.out}
        options["against_baselines"] = self.baselines
        found = bench_pairs(self.recordings, values, **options, report=report)
        print(json.dumps(found) if self.json else markdown(found))
