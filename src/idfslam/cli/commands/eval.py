"""`idf-slam eval`."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tyro.conf import Positional

from idfslam.cli.commands.command import output

if TYPE_CHECKING:
    from rich.console import Console


@dataclass(frozen=True)
class Eval:
    """Compare a run with ground truth.

    It prints the errors of trajectory and mesh, and writes evaluation.json and pictures.
    """

    folder: Positional[Path]
    """Result folder."""
    gt: Path | None = None
    """True trajectory, camera-to-world: TUM (stamp tx ty tz qx qy qz qw), EuRoC's csv, or matrices of 12 or 16 numbers (KITTI), one for
    each frame. Default: the recording's own."""
    gt_mesh: Path | None = None
    """True mesh [m], in the frame of the true trajectory. Default: that of a generated recording; for others, no mesh is evaluated."""
    protocol: Literal["seen", "nice", "neural-rgbd", "coslam", "eslam"] | None = None
    """Protocol of the mesh evaluation: which part of the true surface counts, and how it is sampled. Default: `seen`."""

    def __call__(self, console: "Console") -> None:
        from idfslam.cli.tables import print_evaluation
        from idfslam.runs.evaluate_run import evaluate_folder

        evaluation = evaluate_folder(self.folder, gt=self.gt, gt_mesh=self.gt_mesh, protocol=self.protocol)
        print_evaluation(evaluation, self.folder, output())
