"""How exactly a wrong camera is found, and what that is worth: a hand-held Kinect in generated rooms, whose camera is stated wrongly.

    python benchmarks/calibration.py [CASE ...] [--seeds N] [--frames N] [--width N]

CASE is `right`, `faults` (those of SCENE:handheld-calibration: focal length, centre, depth scale and warp), or values such as `focal=1.1`,
`centre=8` [px at a width of 640] and `depth=1.03`, joined with +. Seed S has a room and a motion of its own. It prints a line in Markdown
for each case and seed: errors of what was found, in brackets those in standard deviations, and the ATE RMSE with the stated camera and with
the one that was found. The scale of depth is taken from the true poses (`idf-slam calibrate --truth`).
"""

import argparse
import tempfile
from collections.abc import Sequence
from dataclasses import replace
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
from idfslam.datasets.generated.handheld import HandheldRecording, handheld_room  # noqa: E402
from idfslam.datasets.recalibrated import Recalibrated  # noqa: E402
from idfslam.datasets.recording import Selection  # noqa: E402
from idfslam.errors import ConfigError, RecordingError  # noqa: E402
from idfslam.evaluation.trajectory_error import absolute_trajectory_error  # noqa: E402
from idfslam.frame import Frame  # noqa: E402
from idfslam.runs.calibrated_camera import write_camera  # noqa: E402
from idfslam.runs.calibration import calibrate_from  # noqa: E402
from idfslam.runs.calibration_keyframes import keyframes_by_slam  # noqa: E402
from idfslam.runs.source import read_frames  # noqa: E402
from idfslam.slam import Slam  # noqa: E402

_ASKED = ("focal", "cx", "cy", "depth_scale")


class Rendered:
    """A recording whose frames are rendered once."""

    def __init__(self, recording: HandheldRecording) -> None:
        self.name, self.camera, self.timestamps = recording.name, recording.camera, recording.timestamps
        self.ground_truth = recording.ground_truth
        self._frames = [recording[i] for i in range(len(recording))]

    def __len__(self) -> int:
        return len(self._frames)

    def __getitem__(self, i: int) -> Frame:
        return self._frames[i]

    def surface(self) -> None:
        """Not needed."""


def stated(case: str, seed: int, frames: int, width: int) -> tuple[Dataset, Dataset, dict[str, float]]:
    """The recording, the same with the camera of a case, and the true deviations from that."""
    size = frames, width, width * 3 // 4
    if case == "faults":
        recording = handheld_room(Faults.named("calibration"), seed, *size)
        m, true, c = recording.miscalibration, recording.true_camera, recording.camera
        depth = 1 / (1 + m.scale + m.warp * (1 / 3 + 2 / 4.5 - 1)) - 1  # on the average of the image, at 2 m
        off = {"focal": true.fx / c.fx - 1, "cx": (true.cx - c.cx) / width, "cy": (true.cy - c.cy) / width, "depth_scale": depth}
        rendered = Rendered(recording)
        return rendered, rendered, off
    ideal = Rendered(handheld_room(Faults.named("ideal"), seed, *size))
    values = {} if case == "right" else {name: float(value) for name, value in (pair.split("=") for pair in case.split("+"))}
    if not values.keys() <= {"focal", "centre", "depth"}:
        raise ConfigError(f"case '{case}', expected right, faults, or focal=, centre= and depth= joined with +")
    c, focal, shift = ideal.camera, values.get("focal", 1.0), values.get("centre", 0.0) * width / 640
    camera = Calibration(c.fx * focal, c.fy * focal, c.cx + shift, c.cy, depth_scale=1 / values.get("depth", 1.0))
    off = {"focal": 1 / focal - 1, "cx": -shift / width, "cy": 0.0, "depth_scale": 1 / values.get("depth", 1.0) - 1}
    return ideal, Recalibrated(ideal, camera), off


def ate_cm(recording: Dataset) -> float:
    """ATE RMSE [cm] of the fast preset."""
    slam = Slam(replace(FAST, calibrate="off"))
    for frame, _ in read_frames(recording):
        slam.process(frame)
    slam.finish()
    assert recording.ground_truth is not None
    return 100 * absolute_trajectory_error(slam.trajectory(), recording.ground_truth).translation.rmse


def row(case: str, seed: int, frames: int, width: int) -> str:
    """The line of a case and seed."""
    stored, recording, true = stated(case, seed, frames, width)
    before = ate_cm(recording)
    try:
        estimate, _, _ = calibrate_from(keyframes_by_slam(recording, FAST), truth=True)
    except RecordingError as error:
        return f"| {case} | {seed} | {error} |"
    found, cells = confirmed(estimate).values, []
    for name, unit in zip(_ASKED, (100.0, 640.0, 640.0, 100.0)):
        i = NAMES.index(name)
        sigma = float(estimate.sigmas[i])
        off = f"{(estimate.model.values[i] - true[name]) / sigma:+.1f}" if sigma else "not determined"
        cells.append(f"{unit * (found[i] - true[name]):+.2f} ({off})")
    with tempfile.TemporaryDirectory() as folder:
        write_camera(Path(folder) / "camera.json", estimate, recording)
        calibrated = Recalibrated(stored, read_given(Path(folder) / "camera.json"))
    return f"| {case} | {seed} | {' | '.join(cells)} | {before:.2f} | {ate_cm(Selection(calibrated)):.2f} |"


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="*", default=["right", "faults", "focal=1.1", "focal=0.9"])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--frames", type=int, default=400)
    parser.add_argument("--width", type=int, default=320)
    given = parser.parse_args(arguments)
    columns = "case", "seed", "focal [%]", "cx [px]", "cy [px]", "depth scale [%]", "ATE stated [cm]", "ATE found [cm]"
    print("| " + " | ".join(columns) + " |\n|---|" + "---:|" * (len(columns) - 1), flush=True)
    for case in given.cases:
        for seed in range(given.seeds):
            print(row(case, seed, given.frames, given.width), flush=True)


if __name__ == "__main__":
    np.seterr(all="raise", under="ignore")
    main()
