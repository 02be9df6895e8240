"""The progress of a run: a bar in a terminal, and lines of text elsewhere (a file, a pipe, a service's journal)."""

from time import monotonic
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from idfslam.frame import FrameResult, Status

_WIDE = 140  # [columns] of a terminal that shows every loss, a narrower one the first; larger: fewer terminals show all
_SETTLED = 30  # frames after which the time left is estimated; fewer: compiling and the first frame count too much. Chosen by hand
_BETWEEN_LINES = 10.0  # [s] between two lines of text; larger: shorter logs, told later. Chosen by hand


class ProgressBar:
    """Shows the progress of a run of `total` frames (None: unknown). Without a console it shows nothing."""

    def __init__(self, total: int | None, console: Console | None) -> None:
        columns = (TextColumn("{task.description}"), BarColumn(bar_width=10), MofNCompleteColumn(), TimeRemainingColumn())
        fields = (TextColumn("{task.fields[speed]}"), TextColumn("{task.fields[counts]}"), TextColumn("{task.fields[losses]}", style="dim"))
        in_terminal = console is not None and console.is_interactive
        self._progress = Progress(*columns, *fields, console=console, disable=not in_terminal)
        self._task = self._progress.add_task("frames", total=total, speed="", counts="", losses="")
        self._lines = None if console is None or in_terminal else console
        self._next_line = monotonic()  # [s]
        self._total, self._done, self._first = total, 0, 0
        self._keyframes = self._lost = self._doubtful = 0

    def __enter__(self) -> "ProgressBar":
        self._progress.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._progress.stop()

    def resume(self, *, done: int, keyframes: int, lost: int, doubtful: int) -> None:
        """Sets the counts of the frames done before the run was resumed."""
        self._done, self._first, self._keyframes, self._lost, self._doubtful = done, done, keyframes, lost, doubtful
        self._progress.update(self._task, completed=done)

    def update(self, result: FrameResult, *, frames_per_second: float, keyframes: int | None) -> None:
        """Counts and shows a frame. keyframes: stored ones, as in metrics.json; None: as many as before."""
        self._done += 1
        self._keyframes = self._keyframes if keyframes is None else keyframes
        self._lost += result.status is Status.LOST
        self._doubtful += result.status is Status.DOUBTFUL
        speed, counts = f"{frames_per_second:.2f} frames/s", self._counts()
        self._progress.update(self._task, advance=1, description="frames", speed=speed, counts=counts)
        if result.losses:
            shown = list(result.losses.items())[: None if self._progress.console.width >= _WIDE else 1]
            self._progress.update(self._task, losses=" ".join(f"{name} {value:.3g}" for name, value in shown))
        if self._lines is not None and monotonic() >= self._next_line:
            total = "" if self._total is None else f" of {self._total}"
            self._line(f"frames {self._done}{total}, {speed}{self._left(frames_per_second)}, {counts}")

    def finish(self, *, keyframes: int, lost: int, doubtful: int) -> None:
        """Sets the counts at the end of the run, when submaps have been merged and lost frames interpolated."""
        self._keyframes, self._lost, self._doubtful = keyframes, lost, doubtful
        self._progress.update(self._task, counts=self._counts())

    def describe(self, stage: str) -> None:
        """Shows the name of the present stage."""
        self._progress.update(self._task, description=stage)
        self._line(stage)

    def _counts(self) -> str:
        counts = {"keyframes": self._keyframes, "lost": self._lost, "doubtful": self._doubtful}
        return ", ".join(f"{name} {count}" for name, count in counts.items() if count or name == "keyframes")

    def _left(self, frames_per_second: float) -> str:
        """The estimated time left, if it can be told."""
        if self._total is None or self._done - self._first < _SETTLED:
            return ""
        return f", {_clock((self._total - self._done) / frames_per_second)} left"

    def _line(self, text: str) -> None:
        if self._lines is not None:
            self._lines.print(text, highlight=False, markup=False, soft_wrap=True)
            self._next_line = monotonic() + _BETWEEN_LINES


def _clock(seconds: float) -> str:
    """A duration as minutes and seconds, with hours if it has any."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"
