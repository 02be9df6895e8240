"""`idf-slam calibrate`."""

import logging
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import OmitArgPrefixes, Positional

from idfslam.cli.commands.command import ConfigFile, Values, output
from idfslam.cli.plain_text import plain_printer
from idfslam.cli.recording_flags import CameraFlags, RecordingFlags, recording_source
from idfslam.config import FAST, check

if TYPE_CHECKING:
    from rich.console import Console


log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Calibrate:
    """Find out whether a camera is as stated, from recordings with it.

    It runs SLAM and then adjusts keyframes, landmarks and the camera together: focal lengths, principal point, distortion, and the warp of
    depth. SLAM itself finds the read-out times of its rows and the delay of depth, where the camera moves fast. What the recordings do not
    determine is left as it is. Move the camera around a textured room, near and far, and turn it about all axes, its viewing axis too.
    """

    recordings: Positional[tuple[Path, ...]]
    """Recordings of one camera, or result folders of `run`."""
    out: Path | None = None
    """File to write the camera to: for `run --camera-file`, or as cam_params.json in the folder of a recording."""
    truth: bool = False
    """Take the scale of depth from the recordings' true poses: images and depth alone fit together at any scale."""
    recording: OmitArgPrefixes[RecordingFlags] = field(default_factory=RecordingFlags)
    camera: CameraFlags = field(default_factory=CameraFlags)
    values: Values = FAST
    config: ConfigFile = None

    def __call__(self, console: "Console") -> None:
        values = check(self.values)
        from idfslam.adjustment.camera_findings import findings
        from idfslam.adjustment.sensor_times import time_findings
        from idfslam.cli.tables import print_calibration
        from idfslam.runs.calibrated_camera import check_camera_path, write_camera
        from idfslam.runs.calibration import calibrate, unexplained

        if self.out is not None:
            check_camera_path(self.out)
        sources = [recording_source(path, self.recording, self.camera) for path in self.recordings]
        estimate, recording, times = calibrate(sources, values, truth=self.truth, console=console)
        print_calibration([*findings(estimate), *time_findings(times)], estimate.landmarks, estimate.sightings, estimate.noise, output())
        if not estimate.explains_images:
            log.warning("%s; do not rely on these values", unexplained(estimate))
        if self.out is not None:
            write_camera(self.out, estimate, recording, times)
            plain_printer(output())(f"{self.out}: give it to `idf-slam run --camera-file`")
