"""The progress bar of a run: frames a second, keyframes, lost frames, losses."""

from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from idfslam.frame import FrameResult, Status

_WIDE = 140  # [columns] a terminal at least as wide shows every loss, a narrower one the first


class ProgressBar:
    """Shows the progress of a run of `total` frames (None: unknown). Without a console it shows nothing."""

    def __init__(self, total: int | None, console: Console | None) -> None:
        columns = (TextColumn("{task.description}"), BarColumn(bar_width=10), MofNCompleteColumn(), TimeRemainingColumn())
        fields = (TextColumn("{task.fields[speed]}"), TextColumn("{task.fields[counts]}"), TextColumn("{task.fields[losses]}", style="dim"))
        self._progress = Progress(*columns, *fields, console=console, disable=console is None)
        self._task = self._progress.add_task("frames", total=total, speed="", counts="", losses="")
        self._keyframes = self._lost = 0

    def __enter__(self) -> "ProgressBar":
        self._progress.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._progress.stop()

    def resume(self, *, done: int, keyframes: int, lost: int) -> None:
        """Sets the counts of the frames done before the run was resumed."""
        self._keyframes, self._lost = keyframes, lost
        self._progress.update(self._task, completed=done)

    def update(self, result: FrameResult, *, frames_per_second: float) -> None:
        """Counts and shows a frame."""
        self._keyframes += result.keyframe
        self._lost += result.status is Status.LOST
        counts = f"keyframes {self._keyframes}" + (f", lost {self._lost}" if self._lost else "")
        speed = f"{frames_per_second:.2f} frames/s"
        self._progress.update(self._task, advance=1, speed=speed, counts=counts)
        if result.losses:
            shown = list(result.losses.items())[: None if self._progress.console.width >= _WIDE else 1]
            self._progress.update(self._task, losses=" ".join(f"{name} {value:.3g}" for name, value in shown))

    def describe(self, stage: str) -> None:
        """Shows the name of the present stage."""
        self._progress.update(self._task, description=stage)
