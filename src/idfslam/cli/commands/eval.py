"""`idf-slam eval`."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tyro.conf import Positional

from idfslam.cli.commands.command import output
from idfslam.cli.usage import wrong_usage

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
    views: bool = False
    """Compare rendered views with the frames that `run --hold-out` kept aside, instead: PSNR and SSIM over all pixels, in views.json and
    held_out_views.png. No ground truth is needed."""
    colour: Literal["images", "map"] = "images"
    """What --views renders: the `images` of the archive, or the colour that the `map` has learnt."""

    def __call__(self, console: "Console") -> None:
        if self.views:
            self._views(console)
            return
        if self.colour != "images":
            wrong_usage("eval: --colour belongs to --views", "eval")
        from idfslam.cli.tables import print_evaluation
        from idfslam.runs.evaluate_run import evaluate_folder

        evaluation = evaluate_folder(self.folder, gt=self.gt, gt_mesh=self.gt_mesh, protocol=self.protocol)
        print_evaluation(evaluation, self.folder, output())

    def _views(self, console: "Console") -> None:
        if given := [name for name in ("gt", "gt_mesh", "protocol") if getattr(self, name) is not None]:
            flags = ", ".join(f"--{name.replace('_', '-')}" for name in given)
            wrong_usage(f"eval: --views compares with the recording's images: leave out {flags}", "eval")
        from idfslam.cli.tables import print_views
        from idfslam.pictures.view_comparison import compare_views
        from idfslam.runs.finished_run import FinishedRun

        print_views(compare_views(FinishedRun(self.folder), of_map=self.colour == "map", console=console), self.folder, output())
