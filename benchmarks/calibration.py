"""How exactly a wrong camera is told and found, and what that is worth: generated rooms, whose camera is stated wrongly.

    python benchmarks/calibration.py [CASE ...] [--sensor handheld|kinect|noise-free] [--seeds N] [--frames N] [--width N]

CASE is `right`, `faults` (those of SCENE:handheld-calibration: focal length, centre, depth scale and warp), or values such as `focal=1.1`,
`centre=8` [px at a width of 640] and `depth=1.03`, joined with +. Seed S has a room and a motion of its own. It prints a line in Markdown
for each case and seed: what `run` told and at which frame, errors of what `calibrate` found, in brackets those in standard deviations, lost
frames, and the ATE RMSE with the stated camera, with the one that was found, and with the true one. The camera is found from the keyframes
of the run; the scale of depth is taken from the true poses (`idf-slam calibrate RESULT_FOLDER --truth`).
"""

import argparse
import logging
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from idfslam.compute.process import prepare_process

prepare_process()

from idfslam.adjustment.camera_model import NAMES  # noqa: E402
from idfslam.adjustment.self_calibration import confirmed  # noqa: E402
from idfslam.config import FAST  # noqa: E402
from idfslam.datasets import Dataset  # noqa: E402
from idfslam.datasets.cameras.calibration import Calibration  # noqa: E402
from idfslam.datasets.cameras.camera_files import read_given  # noqa: E402
from idfslam.datasets.generated.faults import Faults  # noqa: E402
from idfslam.datasets.generated.handheld import handheld_room  # noqa: E402
from idfslam.datasets.generated.room import SyntheticRoom  # noqa: E402
from idfslam.datasets.recalibrated import Recalibrated  # noqa: E402
from idfslam.datasets.recording import Selection  # noqa: E402
from idfslam.errors import ConfigError, RecordingError  # noqa: E402
from idfslam.evaluation.trajectory_error import absolute_trajectory_error  # noqa: E402
from idfslam.frame import Frame, Status  # noqa: E402
from idfslam.runs.calibrated_camera import write_camera  # noqa: E402
from idfslam.runs.calibration import calibrate_from  # noqa: E402
from idfslam.runs.calibration_keyframes import keyframes_in  # noqa: E402
from idfslam.runs.source import read_frames  # noqa: E402
from idfslam.slam import Slam  # noqa: E402

_ASKED = ("focal", "cx", "cy", "depth_scale")
_SENSORS = ("handheld", "kinect", "noise-free")


class Told(logging.Handler):
    """What the check of the camera tells, and at which frame."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.frame, self.lines = 0, list[str]()

    def emit(self, record: logging.LogRecord) -> None:
        """Keeps the doubts alone."""
        doubts = record.getMessage().partition(": ")[2].partition("; `idf-slam")[0]
        self.lines.append(f"{doubts.replace('looks ', '')} (frame {self.frame})")


class Rendered:
    """A recording whose frames are rendered once."""

    def __init__(self, recording: Dataset) -> None:
        self.name, self.camera, self.timestamps = recording.name, recording.camera, recording.timestamps
        self.ground_truth = recording.ground_truth
        self._frames = [recording[i] for i in range(len(recording))]

    def __len__(self) -> int:
        return len(self._frames)

    def __getitem__(self, i: int) -> Frame:
        return self._frames[i]

    def surface(self) -> None:
        """Not needed."""


def right(sensor: str, seed: int, frames: int, width: int) -> Rendered:
    """The recording whose camera is right."""
    height = width * 3 // 4
    if sensor == "handheld":
        return Rendered(handheld_room(Faults.named("ideal"), seed, frames, width, height))
    return Rendered(SyntheticRoom(seed, frames, width, height, noise=sensor == "kinect"))


def stated(case: str, sensor: str, seed: int, frames: int, width: int) -> tuple[Dataset, Dataset, dict[str, float]]:
    """The recording, the same with the camera of a case, and the true deviations from that."""
    if case == "faults":
        recording = handheld_room(Faults.named("calibration"), seed, frames, width, width * 3 // 4)
        m, true, c = recording.miscalibration, recording.true_camera, recording.camera
        depth = 1 / (1 + m.scale + m.warp * (1 / 3 + 2 / 4.5 - 1)) - 1  # on the average of the image, at 2 m
        off = {"focal": true.fx / c.fx - 1, "cx": (true.cx - c.cx) / width, "cy": (true.cy - c.cy) / width, "depth_scale": depth}
        rendered = Rendered(recording)
        return rendered, rendered, off
    ideal = right(sensor, seed, frames, width)
    values = {} if case == "right" else {name: float(value) for name, value in (pair.split("=") for pair in case.split("+"))}
    if not values.keys() <= {"focal", "centre", "depth"}:
        raise ConfigError(f"case '{case}', expected right, faults, or focal=, centre= and depth= joined with +")
    c, focal, shift = ideal.camera, values.get("focal", 1.0), values.get("centre", 0.0) * width / 640
    camera = Calibration(c.fx * focal, c.fy * focal, c.cx + shift, c.cy, depth_scale=1 / values.get("depth", 1.0))
    off = {"focal": 1 / focal - 1, "cx": -shift / width, "cy": 0.0, "depth_scale": 1 / values.get("depth", 1.0) - 1}
    return ideal, Recalibrated(ideal, camera), off


def run_over(recording: Dataset) -> tuple[Slam, float, Told]:
    """A run of the fast preset, its ATE RMSE [cm], and what it told."""
    slam, told, log = Slam(FAST), Told(), logging.getLogger("idfslam.slam.keyframe_adjustment.camera_check")
    log.addHandler(told)
    for frame, _ in read_frames(recording):
        slam.process(frame)
        told.frame = frame.index
    slam.finish()
    log.removeHandler(told)
    assert recording.ground_truth is not None
    return slam, 100 * absolute_trajectory_error(slam.trajectory(), recording.ground_truth).translation.rmse, told


def row(case: str, seed: int, sensor: str, frames: int, width: int, of_right: dict[int, str]) -> str:
    """The line of a case and seed. of_right: ATE [cm] with the true camera, by seed, which is filled."""
    stored, recording, true = stated(case, sensor, seed, frames, width)
    if seed not in of_right:
        twin = right("handheld", seed, frames, width) if case == "faults" else stored
        of_right[seed] = f"{run_over(Selection(twin))[1]:.2f}"
    slam, before, told = run_over(Selection(recording))
    lost = sum(status is Status.LOST for status in slam.statuses())
    cells = ["; ".join(told.lines) or "-", str(lost)]
    try:
        estimate, _, _ = calibrate_from(keyframes_in(slam, recording), truth=True)
    except RecordingError as error:
        return f"| {case} | {seed} | {' | '.join(cells)} | {error} |"
    found = confirmed(estimate).values
    for name, unit in zip(_ASKED, (100.0, 640.0, 640.0, 100.0)):
        i = NAMES.index(name)
        sigma = float(estimate.sigmas[i])
        off = f"{(estimate.model.values[i] - true[name]) / sigma:+.1f}" if sigma else "not determined"
        cells.append(f"{unit * (found[i] - true[name]):+.2f} ({off})")
    with tempfile.TemporaryDirectory() as folder:
        write_camera(Path(folder) / "camera.json", estimate, recording)
        calibrated = Recalibrated(stored, read_given(Path(folder) / "camera.json"))
    after = run_over(Selection(calibrated))[1]
    return f"| {case} | {seed} | {' | '.join(cells)} | {before:.2f} | {after:.2f} | {of_right[seed]} |"


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="*", default=["right", "faults", "focal=1.1", "focal=0.9"])
    parser.add_argument("--sensor", choices=_SENSORS, default=_SENSORS[0])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--frames", type=int, default=400)
    parser.add_argument("--width", type=int, default=320)
    given = parser.parse_args(arguments)
    values = "focal [%]", "cx [px]", "cy [px]", "depth scale [%]"
    columns = "case", "seed", "told", "lost", *values, "ATE stated [cm]", "found", "true"
    print("| " + " | ".join(columns) + " |\n|---|" + "---:|" * (len(columns) - 1), flush=True)
    of_right = dict[int, str]()
    for case in given.cases:
        for seed in range(given.seeds):
            print(row(case, seed, given.sensor, given.frames, given.width, of_right), flush=True)


if __name__ == "__main__":
    np.seterr(all="raise", under="ignore")
    main()
