"""`idf-slam pretrain`."""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from idfslam.cli.plain_text import plain_printer
from idfslam.config import PRETRAIN, PretrainConfig, check

if TYPE_CHECKING:
    from rich.console import Console


@dataclass(frozen=True)
class Pretrain:
    """Train the tracker's features on recordings, self-supervised.

    It needs no poses. Under torchrun the work is divided among its processes.
    """

    recordings: Positional[tuple[Path, ...]]
    """Recordings, as for `run`."""
    values: Annotated[PretrainConfig, arg(name="")] = PRETRAIN
    out: Path = Path("weights.safetensors")
    """File of the trained weights (safetensors), for `run --tracker.weights`. The checkpoint is written next to it."""
    start: Path | None = None
    """File of weights to start from. Default: random weights."""
    resume: bool = False
    """Continue from the checkpoint next to --out."""
    overwrite: bool = False
    """Replace the weights and the checkpoint of an earlier training."""
    checkpoint_every: int = 500
    """Save a checkpoint every N steps (0: only at the end). Ctrl-C saves one too."""
    validate: tuple[Path, ...] = ()
    """Recordings for validation. None of their frames is trained on."""
    validate_every: int = 500
    """Validate every N steps (0: only at the end)."""
    log: Path | None = None
    """Folder for TensorBoard logs. It needs the package tensorboard (the extra [train])."""

    def __call__(self, console: "Console") -> None:
        values = check(self.values)
        from rich.progress import Progress

        from idfslam.datasets import open_recording
        from idfslam.pretraining.pretraining import Outputs, pretrain

        recordings, held = ([open_recording(path) for path in paths] for paths in (self.recordings, self.validate))
        outputs = Outputs(self.out, self.log, self.checkpoint_every, self.validate_every)
        first = os.environ.get("RANK", "0") == "0"  # of the processes that torchrun starts
        with Progress(console=console, disable=not first) as progress:
            task = progress.add_task("pretraining", total=values.steps)

            def report(done: int, figures: Mapping[str, float]) -> None:
                losses = " ".join(f"{name} {value:.3g}" for name, value in figures.items() if "/" not in name)
                progress.update(task, completed=done, description=f"pretraining: {losses}")
                validation = " ".join(f"{name} {value:.3g}" for name, value in figures.items() if "/" in name)
                if validation:
                    plain_printer(progress.console)(f"step {done}: {validation}")

            again = {"resume": self.resume, "overwrite": self.overwrite}
            pretrain(recordings, outputs, values, held=held, start=self.start, **again, report=report)
        if first:
            print(self.out)
