"""What each fault of a real sensor costs: the same hand-held motion with an ideal sensor, with each fault alone, and with all of them.

    python benchmarks/sensor_faults.py [SCENE ...] [--seeds N] [--first N] [--frames N] [--size WxH] [--faults NAME ...]
                                       [--preset NAME] [section.value=...]

SCENE is `synthetic` or `corridor`; seed S runs the recording SCENE:S:handheld-FAULT, so that each seed has a room and a motion of its own.
--size renders smaller images than the recording of that name has, which takes less time.
--faults names other rows, such as `shutter=0.5` or `shutter+time`; `all` means every fault. It prints a table in Markdown: the mean and the
standard deviation over the seeds of the ATE RMSE at the end of the run, and that of each seed; and as they were reported when the frames
were processed, the error of the motion from one frame to the next, its largest value of all seeds, and the share of each status.
"""

import argparse
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from idfslam.compute.process import prepare_process

prepare_process()

import torch  # noqa: E402
import yaml  # noqa: E402

from idfslam.config import Config, preset, update  # noqa: E402
from idfslam.datasets import open_recording  # noqa: E402
from idfslam.datasets.generated.faults import FAULTS, IDEAL, Faults  # noqa: E402
from idfslam.datasets.generated.handheld import handheld_corridor, handheld_room  # noqa: E402
from idfslam.datasets.recording import Dataset, Selection  # noqa: E402
from idfslam.evaluation.trajectory_error import absolute_trajectory_error, relative_pose_error  # noqa: E402
from idfslam.frame import Status  # noqa: E402
from idfslam.runs.source import read_frames  # noqa: E402
from idfslam.slam import Slam  # noqa: E402

_ALL = "all"
_COLUMNS = (
    "sensor", "ATE RMSE [cm]", "of each [cm]", "times ideal", "RPE of a frame [degrees]", "largest jump [degrees]", "[cm]",
    *(f"{status.value} [%]" for status in Status), "lost frames",
)  # fmt: skip


@dataclass(frozen=True)
class Measured:
    """One run."""

    ate: float  # [cm] RMSE
    turn: float  # [degrees] RMSE over one frame
    jump: tuple[float, float]  # [degrees], [cm] largest error over one frame
    statuses: Counter[Status]


def opened(scene: str, seed: int, faults: str, frames: int | None, size: tuple[int, int] | None) -> Dataset:
    """The recording of a row; size: (width, height) of its images, None: those of the recording of its name."""
    name = f"{scene}:{seed}:handheld" + ("" if faults == _ALL else f"-{faults}")
    if size is None:
        return open_recording(name, frames=frames)
    make = handheld_room if scene == "synthetic" else handheld_corridor
    return Selection(make(Faults.named(None if faults == _ALL else faults), seed, width=size[0], height=size[1]), frames=frames)


def measured(recording: Dataset, config: Config) -> Measured:
    """Runs a recording."""
    slam = Slam(config)
    statuses = Counter(slam.process(frame).status for frame, _ in read_frames(recording))
    slam.finish()
    poses, truth = slam.trajectory(), np.asarray(recording.ground_truth)
    rpe = relative_pose_error(slam.live_trajectory(), truth)
    if rpe is None:
        raise SystemExit(f"{recording.name}: {len(poses)} frames, expected at least 2: choose --frames")
    jump = rpe.largest_jump
    ate = absolute_trajectory_error(poses, truth).translation.rmse
    return Measured(100 * ate, rpe.rotation.rmse, (jump.rotation_deg, 100 * jump.translation_m), statuses)


def row(name: str, runs: Sequence[Measured], ideal: float | None) -> str:
    """A row of the table; `ideal` is the mean error [cm] of the ideal sensor."""
    errors = np.array([run.ate for run in runs])
    statuses = sum((run.statuses for run in runs), Counter[Status]())
    ratio = "-" if ideal is None else f"{errors.mean() / ideal:.1f}"
    jumps = " | ".join(f"{max(run.jump[k] for run in runs):.1f}" for k in range(2))
    shares = " | ".join(f"{100 * statuses[status] / statuses.total():.1f}" for status in Status)
    turn, each = np.mean([run.turn for run in runs]), ", ".join(f"{error:.2f}" for error in errors)
    mean, lost = f"{errors.mean():.2f} ± {errors.std():.2f}", statuses[Status.LOST]
    return f"| {name} | {mean} | {each} | {ratio} | {turn:.2f} | {jumps} | {shares} | {lost} |"


def configured(name: str, values: Sequence[str]) -> Config:
    """The preset with `section.value=...` of the command line."""
    config = preset(name)
    for argument in values:
        path, value = argument.split("=")
        nested = yaml.safe_load(value)
        for part in reversed(path.split(".")):
            nested = {part: nested}
        config = update(config, nested, "the command line")
    return config


def image_size(text: str) -> tuple[int, int]:
    """(width, height) [px] of "320x240"."""
    width, height = map(int, text.split("x"))
    return width, height


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", help="synthetic or corridor, and section.value=... of the configuration")
    parser.add_argument("--seeds", type=int, default=1, help="number of seeds of scene, motion and system")
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--frames", type=int, help="number of frames of each recording; default: all")
    parser.add_argument("--size", type=image_size, help="size of the images, such as 320x240; default: the recording's own")
    parser.add_argument("--faults", nargs="+", default=[IDEAL, *FAULTS, _ALL], help="rows of the table")
    parser.add_argument("--preset", default="fast")
    arguments = parser.parse_args()
    config = configured(arguments.preset, [name for name in arguments.scenes if "=" in name])
    torch.set_num_threads(1)
    for scene in [name for name in arguments.scenes if "=" not in name] or ["synthetic"]:
        header = "| " + " | ".join(_COLUMNS) + " |\n|---|" + "---:|" * (len(_COLUMNS) - 1)
        print(f"\n{scene}, {arguments.seeds} seeds from {arguments.first} on\n\n{header}", flush=True)
        ideal: float | None = None
        for faults in arguments.faults:
            seeds = range(arguments.first, arguments.first + arguments.seeds)
            recordings = {seed: opened(scene, seed, faults, arguments.frames, arguments.size) for seed in seeds}
            runs = [measured(recording, replace(config, seed=seed)) for seed, recording in recordings.items()]
            if faults == IDEAL:
                ideal = float(np.mean([run.ate for run in runs]))
            print(row(faults, runs, ideal), flush=True)


if __name__ == "__main__":
    main()
