"""Doubt: which share of wrong poses is called good, which share of good ones bad, and are the covariances honest?

    python benchmarks/doubt.py RECORDING ... [--seeds N] [--frames N] [--preset NAME] [--plot reliability.png] [section.value=...]

Each recording must have ground truth. Every frame is judged as it was reported when it was processed (`idfslam.evaluation.doubt`), and its
covariance is held against the error of the motion since the last keyframe (`idfslam.evaluation.consistency`). It prints tables in Markdown:
a row for each recording over its seeds, one for all, and the bins of the reliability plot.
"""

import argparse
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from idfslam.compute.process import prepare_process

prepare_process()

import torch  # noqa: E402
import yaml  # noqa: E402

from idfslam.config import Config, preset, update  # noqa: E402
from idfslam.datasets import open_recording  # noqa: E402
from idfslam.evaluation.consistency import MotionErrors, reliability, share_inside  # noqa: E402
from idfslam.evaluation.doubt import DoubtRates, ReportedFrames, confidence, doubt_rates  # noqa: E402
from idfslam.evaluation.plots import plot_reliability  # noqa: E402
from idfslam.runs.source import read_frames  # noqa: E402
from idfslam.slam import Slam  # noqa: E402

_COLUMNS = (
    "recording", "seeds", "off, called good [%]", "good, called bad [%]", "passages missed",
    "NEES mean", "median", "of trusted: mean", "median", "inside 95 % [%]",
)  # fmt: skip


def measured(name: str, config: Config, frames: int | None) -> tuple[DoubtRates, MotionErrors]:
    """The rates and the errors of one run."""
    recording, slam = open_recording(name, frames=frames), Slam(config)
    if recording.ground_truth is None:
        raise SystemExit(f"{name}: has no ground truth; expected a recording with true poses")
    results = [slam.process(frame) for frame, _ in read_frames(recording)]
    reported = ReportedFrames.of(results, corrected={max(pair) for pair in slam.figures()["loops"]})
    truth = np.asarray(recording.ground_truth)[: len(results)]
    return doubt_rates(reported, truth), MotionErrors.of(reported, truth)


def share(found: int, of: int) -> str:
    """A share in per cent with its confidence interval of 95 %, and the two numbers."""
    interval = confidence(found, of)
    if interval is None:
        return "- (no such frame)"
    low, high = interval
    return f"{100 * found / of:.1f} [{100 * low:.1f}, {100 * high:.1f}] ({found} of {of})"


def row(name: str, seeds: int, rates: DoubtRates, errors: MotionErrors) -> str:
    """A row of the table."""
    every, trusted = errors.nees(), errors.where(errors.trusted).nees()
    nees = [f"{values.mean():.2f} | {np.median(values):.2f}" if len(values) else "- | -" for values in (every, trusted)]
    inside = f"{100 * share_inside(every):.0f}" if len(every) else "-"
    missed, alarms = share(rates.missed, rates.off), share(rates.false_alarms, rates.good)
    passages = f"{rates.passages_missed} of {rates.passages}"
    return f"| {name} | {seeds} | {missed} | {alarms} | {passages} | {' | '.join(nees)} | {inside} |"


def print_reliability(errors: MotionErrors) -> None:
    """The bins of the reliability plot as a table."""
    print("\n| error of the motion since the last keyframe | frames | told (RMS) | true (RMS) | true / told |\n|---|---:|---:|---:|---:|")
    for column, name, unit in ((0, "shift [cm]", 100.0), (1, "turn [degrees]", 180 / np.pi)):
        for b in reliability(errors.sigmas[:, column] * unit, errors.sizes[:, column] * unit):
            print(f"| {name} | {b.frames} | {b.predicted:.3f} | {b.actual:.3f} | {b.actual / b.predicted:.2f} |")


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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recordings", nargs="+", help="recordings with ground truth, and section.value=... of the configuration")
    parser.add_argument("--seeds", type=int, default=1, help="number of seeds, from 0 on")
    parser.add_argument("--frames", type=int, help="number of frames of each recording; default: all")
    parser.add_argument("--preset", default="fast")
    parser.add_argument("--plot", type=Path, default=Path("reliability.png"))
    arguments = parser.parse_args()
    values = [word for word in arguments.recordings if re.match(r"[\w.]+=", word)]  # names as synthetic:0:handheld-time=2 are none
    config = configured(arguments.preset, values)
    torch.set_num_threads(1)
    print("| " + " | ".join(_COLUMNS) + " |\n|---|" + "---:|" * (len(_COLUMNS) - 1), flush=True)
    all_rates, all_errors = DoubtRates(), list[MotionErrors]()
    for name in (name for name in arguments.recordings if name not in values):
        runs = [measured(name, replace(config, seed=seed), arguments.frames) for seed in range(arguments.seeds)]
        rates, errors = sum((run[0] for run in runs), DoubtRates()), MotionErrors.joined([run[1] for run in runs])
        print(row(Path(name).name, arguments.seeds, rates, errors), flush=True)
        all_rates, all_errors = all_rates + rates, [*all_errors, errors]
    joined = MotionErrors.joined(all_errors)
    if len(all_errors) > 1:
        print(row("all", arguments.seeds, all_rates, joined))
    if not len(joined.errors):
        print("\nNo frame has a covariance: there is no reliability to plot.")
        return
    print_reliability(joined)
    plot_reliability(arguments.plot, joined.sigmas, joined.sizes)
    print(f"\n{arguments.plot}")


if __name__ == "__main__":
    main()
