"""`idf-slam run`."""

import sys
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NoReturn

from tyro.conf import Positional

from idfslam.cli.commands.command import Values, output
from idfslam.config import FAST, check

if TYPE_CHECKING:
    from rich.console import Console

    from idfslam.viewer.rerun_viewer import Viewer


@dataclass(frozen=True)
class CameraFlags:
    """The camera, where it is not the recording's own; the flags win over what the recording says."""

    fx: float | None = None
    """Focal length [px]."""
    fy: float | None = None
    """Focal length [px]."""
    cx: float | None = None
    """Principal point [px]; pixel centres at integers."""
    cy: float | None = None
    """Principal point [px]."""
    depth_scale: float | None = None
    """Units of the depth images per metre: 1000 for millimetres."""

    def given(self) -> dict[str, float]:
        """Those that are given."""
        return {key: value for key, value in asdict(self).items() if value is not None}


@dataclass(frozen=True)
class TopicFlags:
    """Topics of a ROS recording, where they are not found by themselves."""

    colour: str | None = None
    """Colour images."""
    depth: str | None = None
    """Depth images; named, they are taken to be registered to colour where nothing says otherwise."""
    camera_info: str | None = None
    """The colour camera."""
    poses: str | None = None
    """The ground truth: poses of the camera, or of a frame that /tf_static connects with it."""


_WITH_RESUME = ("resume", "checkpoint_every")  # flags that do not change what a run gives
_USAGE = 2


@dataclass(frozen=True)
class Run:
    """SLAM on a recording or a live camera: trajectory, mesh, map and figures into a folder. Ctrl-C ends it and writes them."""

    path: Positional[Path | None] = None
    """The recording, in any layout that is known; which one is seen from what lies in it. Or a generated one: synthetic[:SEED][:kinect],
    corridor[:SEED][:kinect][:Nlaps]; kidnap: before any of these carries the camera off, five times. Or a live camera:
    realsense[:SERIAL or FILE], opencv:COLOUR:DEPTH (two video devices, with --camera.fx and so on), openni[:NUMBER], orbbec[:NUMBER];
    replay[@SPEED]:PATH plays a recording as if it were one. What comes faster than it can be used is dropped."""
    values: Values = FAST
    out: Path | None = None
    """The result folder; none given: results/ and the recording's name."""
    start: int = 0
    """The first frame."""
    frames: int | None = None
    """How many frames; none given: to the end."""
    stride: int = 1
    """Every so many frames one is taken."""
    format: str | None = None
    """The recording's layout, where it is not to be seen from its files."""
    camera: CameraFlags = CameraFlags()
    topics: TopicFlags = TopicFlags()
    map: Path | None = None
    """The result folder of an earlier run: the camera is found in its map, which is extended. Its recording must still be there."""
    report: bool = True
    """Whether report.html and its pictures are made at the end."""
    config: Path | None = None
    """A YAML file of values (a run's config.yaml, or a few lines of it); flags win over it, and it over the preset."""
    viewer: Literal["none", "auto", "window", "web", "file"] = "none"
    """Look on as it goes: in a window, in a browser (also from another machine), or later (file); --viewer alone is a window where there
    is a display, else the browser. recording.rrd keeps it for `idf-slam view`."""
    port: int = 9090
    """Of the page for --viewer web; the data come from the next one."""

    checkpoint_every: int = 300
    """Every so many frames all that a run needs to go on is written into the result folder; 0: never. It goes when the run is
    over. Not of a live camera, nor with --map."""
    resume: Path | None = None
    """Instead of a recording: the result folder of a run that was ended by Ctrl-C, a crash or a power failure, to go on with."""

    def __call__(self, console: "Console") -> None:
        if self.resume is not None:
            self._go_on(self.resume, console)
            return
        if self.path is None:
            _wrong_usage("expected a recording, or --resume and the result folder of a run")
        values = check(self.values)
        from idfslam.cli.tables import print_run
        from idfslam.live import LiveStream, located
        from idfslam.report.writing import write_report
        from idfslam.runs.prior_map import load_prior
        from idfslam.runs.result_folder import Source
        from idfslam.runs.runner import run
        from idfslam.runs.source import open_feed

        camera = self.camera.given()
        scale = camera.pop("depth_scale", None)
        topics = {key: name for key, name in asdict(self.topics).items() if name is not None}
        source = Source(located(str(self.path)), self.format, camera or None, scale, topics or None, self.start, self.frames, self.stride)
        recording = open_feed(source)
        folder = self.out or Path("results") / recording.name
        prior = None if self.map is None else load_prior(self.map)
        viewer, every = self._viewer(console), self.checkpoint_every
        done = run(recording, values, folder, source=source, prior=prior, console=console, checkpoint_every=every, viewer=viewer)
        if self.report:
            write_report(folder, recording=None if isinstance(recording, LiveStream) else recording)
        print_run(done, output())

    def _go_on(self, folder: Path, console: "Console") -> None:
        given = [f.name for f in fields(self) if f.name not in _WITH_RESUME and getattr(self, f.name) != getattr(Run(), f.name)]
        if given:
            _wrong_usage(
                f"--resume goes on with the recording and the values of {folder}/config.yaml: leave out all else (found {', '.join(given)})"
            )
        from idfslam.cli.tables import print_run
        from idfslam.runs.runner import resume

        done = resume(folder, checkpoint_every=self.checkpoint_every, console=console)
        if done is None:
            output().print(f"{folder}: the run is over, nothing to resume", highlight=False)
        else:
            print_run(done, output())

    def _viewer(self, console: "Console") -> "Viewer":
        from idfslam.viewer.rerun_program import has_display
        from idfslam.viewer.rerun_viewer import NullViewer, RerunViewer

        if self.viewer == "none":
            return NullViewer()
        place = ("window" if has_display() else "web") if self.viewer == "auto" else self.viewer
        viewer = RerunViewer(place, port=self.port)
        if place == "web":
            console.print(f"live view: {viewer.address()}", highlight=False, soft_wrap=True, markup=False)
        return viewer


def _wrong_usage(message: str) -> NoReturn:
    print(f"error: {message}", file=sys.stderr)
    raise SystemExit(_USAGE)
