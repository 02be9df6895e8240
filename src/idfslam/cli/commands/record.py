"""`idf-slam record`."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from idfslam.cli.commands.command import output
from idfslam.cli.plain_text import plain_printer
from idfslam.cli.recording_flags import CameraFlags

if TYPE_CHECKING:
    from rich.console import Console


@dataclass(frozen=True)
class Record:
    """Record a live camera.

    All other commands read the recording. Press Ctrl-C to stop; the recording stays readable.
    """

    source: Positional[Path]
    """A camera: realsense[:SERIAL or FILE], openni[:NUMBER], orbbec[:NUMBER], or opencv:COLOUR:DEPTH for two video devices (with
    --camera.fx and so on). `replay[@SPEED]:PATH` plays a recording like a live camera."""
    out: Path
    """Folder of the new recording. It must not hold a recording already."""
    seconds: float | None = None
    """Length [s]. Default: until Ctrl-C."""
    frames: int | None = None
    """Number of frames. Default: until Ctrl-C."""
    png: bool = False
    """Store colour as PNG, which is exact and several times as large as JPEG. Depth is always exact to the millimetre."""
    camera: CameraFlags = field(default_factory=CameraFlags)

    def __call__(self, console: "Console") -> None:
        from rich.progress import Progress, TextColumn, TimeElapsedColumn

        from idfslam.live import absolute_path, open_live
        from idfslam.live.recorder import record

        stream = open_live(absolute_path(str(self.source)), camera=self.camera.given(), frames=self.frames)
        with Progress(TextColumn("{task.description}"), TimeElapsedColumn(), console=console) as progress:
            task = progress.add_task("waiting for the camera")

            def report(stored: int, dropped: int) -> None:
                progress.update(task, description=f"recording: {stored} frames" + (f", dropped {dropped}" if dropped else ""))

            done = record(stream, self.out, seconds=self.seconds, png=self.png, report=report)
        dropped = f", {done.dropped} dropped" if done.dropped else ""
        output().print(f"{done.frames} frames in {done.seconds:.0f} s{dropped}", highlight=False)
        plain_printer(output())(str(done.folder))
