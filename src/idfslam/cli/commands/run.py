"""`idf-slam run`."""

from collections.abc import Iterator
from dataclasses import dataclass, field, fields, is_dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from tyro.conf import OmitArgPrefixes, Positional

from idfslam.cli.commands.command import ConfigFile, Values, output
from idfslam.cli.plain_text import plain_printer
from idfslam.cli.recording_flags import CameraFlags, RecordingFlags, TopicFlags, recording_source
from idfslam.cli.usage import wrong_usage
from idfslam.config import FAST, check
from idfslam.errors import ConfigError
from idfslam.viewer.rerun_program import LOOPBACK, PORT, ViewerOption

if TYPE_CHECKING:
    from rich.console import Console

    from idfslam.datasets import Dataset
    from idfslam.runs.run_config import RecordingSource
    from idfslam.runs.runner import RunResult
    from idfslam.viewer.viewer import Viewer


@dataclass(frozen=True)
class OutputFlags:
    """The result folder."""

    out: Path | None = None
    """Result folder; it must be new or empty. Default: results/NAME, with a number if that exists."""
    overwrite: bool = False
    """Replace the results in --out; they stay until the new ones are complete."""
    report: bool = True
    """Write report.html with its pictures at the end."""
    lost: Literal["keep", "drop"] = "keep"
    """Frames whose pose was not measured (lost, interpolated) in trajectory.txt. `keep`: it has a line for every frame, and frames.csv
    says which were not measured. `drop`: it leaves them out. Doubtful frames have a measured pose, and stay."""


@dataclass(frozen=True)
class ViewerFlags:
    """The live view."""

    viewer: ViewerOption = "none"
    """Show the run live in a `window`, in a browser (`web`), or record it for `idf-slam view` (`file`). `auto`, or --viewer alone, opens a
    window where there is a display and a page for the browser elsewhere. Every choice records the view in recording.rrd."""
    port: int = PORT
    """Port of the page of --viewer web. Data is served on PORT+1."""
    host: str = LOOPBACK
    """Address of this machine that --viewer web listens on. 0.0.0.0 opens it to the network, without a password."""


@dataclass(frozen=True)
class CheckpointFlags:
    """Checkpoints, and resuming an interrupted run."""

    checkpoint_every: int = 300
    """Save a checkpoint every N frames (0: never). It is deleted when the run completes. Live cameras and runs with --map have none."""
    resume: Path | None = None
    """Continue the run of this result folder, which was ended by Ctrl-C, a crash or a power failure. Give it instead of a recording."""


@dataclass(frozen=True)
class Run:
    """Run SLAM on a recording or a live camera.

    It writes trajectory, mesh, map, metrics and a report to a folder. Press Ctrl-C to stop early; all results so far are saved.
    """

    path: Positional[Path | None] = None
    """A recording; its format is detected automatically. Generated recordings: synthetic[:SEED][:kinect] and
    corridor[:SEED][:kinect][:Nlaps]; with :handheld instead of :kinect they have the faults of a real sensor in a shaking hand.
    Live cameras: realsense[:SERIAL or FILE], openni[:NUMBER], orbbec[:NUMBER], and opencv:COLOUR:DEPTH for two video devices (with
    --camera.fx and so on); frames that come too fast are dropped. `replay[@SPEED]:PATH` plays a recording like a live camera.
    `kidnap:PATH` tests relocalisation: five blackouts of one second, each ending at an earlier place."""
    map: Path | None = None
    """Start in the map of this earlier result folder and extend it. The recording of that run must still exist."""
    truth: bool = True
    """Read the recording's ground truth, for the errors at the end; `--no-truth` leaves it unread."""
    config: ConfigFile = None
    recording: OmitArgPrefixes[RecordingFlags] = field(default_factory=RecordingFlags)
    camera: CameraFlags = field(default_factory=CameraFlags)
    topics: TopicFlags = field(default_factory=TopicFlags)
    output: OmitArgPrefixes[OutputFlags] = OutputFlags()
    live_view: OmitArgPrefixes[ViewerFlags] = ViewerFlags()
    checkpoints: OmitArgPrefixes[CheckpointFlags] = CheckpointFlags()
    values: Values = FAST

    def __call__(self, console: "Console") -> None:
        if self.checkpoints.checkpoint_every < 0:
            raise ConfigError(f"--checkpoint-every {self.checkpoints.checkpoint_every}, expected at least 0, which saves none")
        if self.checkpoints.resume is not None:
            self._go_on(self.checkpoints.resume, console)
            return
        if self.path is None:
            wrong_usage("run: expected a recording, or --resume and the result folder of a run", "run")
        values = check(self.values)
        from idfslam.compute.process import keep_what_is_imported
        from idfslam.compute.torch_threads import limit_torch_threads
        from idfslam.datasets.provenance import is_guessed
        from idfslam.live import LiveStream
        from idfslam.runs.prior_map import load_prior
        from idfslam.runs.run_folder import check_usable, folder_for
        from idfslam.runs.runner import run
        from idfslam.runs.source import open_feed

        wanted = {"overwrite": self.output.overwrite, "report": self.output.report}
        if self.output.out is not None:
            check_usable(self.output.out, **wanted)
        source = recording_source(self.path, self.recording, self.camera, self.topics, truth=self.truth)
        recording = open_feed(source)
        limit_torch_threads(values.field.encoding)
        prior = None if self.map is None else load_prior(self.map)
        viewer, every, overwrite = self._viewer(console), self.checkpoints.checkpoint_every, self.output.overwrite
        folder = folder_for(recording.name, self.output.out, overwrite=overwrite)
        check_usable(folder, **wanted)
        if values.calibrate == "on" or (values.calibrate == "warn" and is_guessed(recording)):
            source = self._calibrated(source, folder, console)
            recording = open_feed(source)
        keep_what_is_imported()
        options: dict[str, Any] = {"prior": prior, "checkpoint_every": every, "overwrite": overwrite, "viewer": viewer}
        done = run(recording, values, folder, source=source, console=console, **options)
        self._conclude(done, console, None if isinstance(recording, LiveStream) else recording)

    def _calibrated(self, source: "RecordingSource", folder: Path, console: "Console") -> "RecordingSource":
        """The recording with the camera that it shows itself, in a file beside the result folder."""
        from idfslam.live import is_live
        from idfslam.runs.calibration import with_own_camera

        if is_live(source.path):
            wrong_usage(
                "--calibrate on reads a recording twice, which a live camera cannot: record it first, or give --calibrate warn", "run"
            )
        return with_own_camera(source, self.values, folder.with_name(f"{folder.name}-camera.json"), console)

    def _go_on(self, folder: Path, console: "Console") -> None:
        output_flags = OutputFlags(report=self.output.report, lost=self.output.lost)
        of_any_run = replace(Run(), output=output_flags, live_view=self.live_view, checkpoints=self.checkpoints)
        given = list(_changed(self, of_any_run))
        if given:
            found = ", ".join(given)
            wrong_usage(f"--resume takes the recording and the values of {folder}/config.yaml: leave out all else (found {found})", "run")
        from idfslam.compute.process import keep_what_is_imported
        from idfslam.compute.torch_threads import limit_torch_threads
        from idfslam.runs.run_config import read_config
        from idfslam.runs.run_folder import config_folder
        from idfslam.runs.runner import resume

        limit_torch_threads(read_config(config_folder(folder))[0].field.encoding)
        keep_what_is_imported()
        done = resume(folder, checkpoint_every=self.checkpoints.checkpoint_every, console=console, viewer=self._viewer(console))
        if done is None:
            output().print(f"{folder}: the run is over, nothing to resume", highlight=False)
            return
        self._conclude(done, console, None)

    def _conclude(self, done: "RunResult", console: "Console", recording: "Dataset | None") -> None:
        """The report and what the options ask for. recording: of the run, if it is open and can be read again."""
        from idfslam.cli.tables import print_run
        from idfslam.report.writing import write_report
        from idfslam.runs.lost_frames import leave_out_lost

        if self.output.report:
            console.print("writing the report", highlight=False)
            write_report(done.folder, recording=recording)
        if self.output.lost == "drop":
            leave_out_lost(done.folder)
        print_run(done, output())

    def _viewer(self, console: "Console") -> "Viewer":
        from idfslam.viewer.rerun_program import has_display, listening
        from idfslam.viewer.rerun_viewer import RerunViewer
        from idfslam.viewer.viewer import NO_VIEWER

        place, port = self.live_view.viewer, self.live_view.port
        if place == "none":
            return NO_VIEWER
        if place == "auto":
            place = "window" if has_display() else "web"
        viewer = RerunViewer(place, port=port, host=self.live_view.host)
        if place == "web":
            plain_printer(console)(f"live view: {viewer.address()}\n{listening(port, self.live_view.host)}")
        return viewer


def _changed(flags: Any, defaults: Any) -> Iterator[str]:
    """The names of the fields, nested ones too, that differ from their defaults."""
    for each in fields(flags):
        value, default = getattr(flags, each.name), getattr(defaults, each.name)
        if is_dataclass(value):
            yield from _changed(value, default)
        elif value != default:
            yield each.name
