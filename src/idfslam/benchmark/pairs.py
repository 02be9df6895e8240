"""The benchmark of pairs: relative poses of frames a few frames apart, by learned features and by classic methods.

All methods get the same pairs. The true poses serve only for comparison.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from idfslam.batch.recordings import parse_recordings
from idfslam.benchmark.machine import machine
from idfslam.benchmark.match_figure import MatchPicture, draw_matches
from idfslam.benchmark.pair_sample import PairSample, sample
from idfslam.benchmark.registration_methods import Estimate, Method, baselines, learned
from idfslam.benchmark.table import markdown_table
from idfslam.config import Config
from idfslam.datasets import Dataset, open_recording
from idfslam.errors import ConfigError
from idfslam.frame import Frame
from idfslam.pretraining.validation import pose_error
from idfslam.storage import atomic_files
from idfslam.storage.ledger import Ledger
from idfslam.tracking.frame_features import reduced

REPORT, TABLE = "pairs.json", "pairs.md"
ROTATIONS = (5, 10)  # [degrees]
TRANSLATIONS = (5, 10, 25)  # [cm]
_WRONG = (5, 15)  # [degrees, cm] an accepted pose with a larger error counts as wrong
_RIGHT = (5, 10)  # [degrees, cm] a pose with smaller errors counts as right


@dataclass
class Tally:
    """Collects the errors and times of one method at one gap."""

    rotation: list[float] = field(default_factory=list)  # [degrees]
    translation: list[float] = field(default_factory=list)  # [cm]
    believed: list[bool] = field(default_factory=list)
    describe: list[float] = field(default_factory=list)  # [ms] a frame
    register: list[float] = field(default_factory=list)  # [ms] a pair that is described

    def figures(self) -> dict[str, float | None]:
        """The values of the report: shares in [0, 1] (None: of an empty set), degrees, cm, ms."""
        rotation, translation, believed = (np.array(values) for values in (self.rotation, self.translation, self.believed))
        right = (rotation < _RIGHT[0]) & (translation < _RIGHT[1])
        wrong = (rotation > _WRONG[0]) | (translation > _WRONG[1])
        return {
            "pairs": len(rotation),
            **{f"rotation_below_{limit}_deg": float((rotation < limit).mean()) for limit in ROTATIONS},
            **{f"translation_below_{limit}_cm": float((translation < limit).mean()) for limit in TRANSLATIONS},
            "rotation_mean_deg": float(rotation.mean()),
            "rotation_median_deg": float(np.median(rotation)),
            "translation_mean_cm": float(translation.mean()),
            "translation_median_cm": float(np.median(translation)),
            "believed": float(believed.mean()),
            "believed_but_wrong": float((believed & wrong).mean()),
            "right_of_believed": _share(right[believed]),
            "doubted_of_not_right": _share(~believed[~right]),
            "ms_a_frame": float(np.median(self.describe)),
            "ms_a_pair": float(2 * np.median(self.describe) + np.median(self.register)),
        }


def _share(those: NDArray[np.bool_]) -> float | None:
    """The share of true values; None for an empty array."""
    return float(those.mean()) if len(those) else None


def bench_pairs(
    recordings: Sequence[str],
    config: Config,
    *,
    gaps: Sequence[int] = (5, 10, 20, 40),
    pairs: int = 100,
    weights: Sequence[Path] = (),
    against_baselines: bool = True,
    folder: Path | None = None,
    report: Callable[[str], None] = lambda line: None,
) -> dict[str, Any]:
    """Measures the errors of our features, those in `weights`, and the baselines, on `pairs` pairs of each recording and gap.

    If `folder` is given, JSON, table and pictures of matches are written there. Raises ConfigError or RecordingError, before the first
    pair, for recordings or values that cannot be measured.
    """
    if pairs < 1 or not gaps or min(gaps) < 1:
        raise ConfigError(f"--pairs {pairs} --gap {' '.join(map(str, gaps))}, expected at least 1 pair and gaps of at least 1 frame")
    opened = {entry.name: open_recording(entry.path, frames=entry.frames) for entry in parse_recordings(recordings)}
    samples = [sample(recording, gap, pairs) for recording in opened.values() for gap in gaps]
    if folder is not None:
        Ledger(folder).refuse_foreign([REPORT, TABLE])
        atomic_files.prepare(folder)
    rows = []
    for taken in samples:
        chosen = learned(config.tracker, weights)
        if against_baselines:
            chosen |= baselines(config.tracker, _images(taken.recording, config.tracker.height), report)
        tallies, picture = _measure(taken, chosen)
        rows += [
            {"recording": taken.recording.name, "gap": taken.gap, "method": name, **tally.figures()} for name, tally in tallies.items()
        ]
        report(f"{taken.recording.name}: {len(taken.starts)} pairs {taken.gap} frames apart")
        if folder is not None:
            with Ledger(folder).replacing(f"matches-{taken.recording.name}-{taken.gap}.png") as part:
                draw_matches(part, picture)
    found = {"machine": machine(), "preset": config.preset, "rows": rows}
    if folder is not None:
        Ledger(folder).write_json(REPORT, found)
        Ledger(folder).write_text(TABLE, markdown(found))
    return found


def _measure(taken: PairSample, chosen: Mapping[str, Method]) -> tuple[dict[str, Tally], list[MatchPicture]]:
    """The tallies of all methods, and the matches of the pair in the middle."""
    tallies: dict[str, Tally] = {name: Tally() for name in chosen}
    pictures: list[MatchPicture] = []
    for place, (keyframe, frame, truth) in enumerate(taken):
        for name, method in chosen.items():
            estimate = _timed(method, frame, keyframe, tallies[name])
            rotation, translation = pose_error(estimate.T_kc, truth)
            tallies[name].rotation.append(rotation)
            tallies[name].translation.append(translation)
            tallies[name].believed.append(estimate.believed)
            if place == len(taken.starts) // 2 and len(estimate.inliers):
                title = f"{name}: {len(estimate.inliers)} inliers, {rotation:.1f} degrees and {translation:.1f} cm off"
                pictures.append(MatchPicture(title, keyframe.colour, frame.colour, estimate.inliers))
    return tallies, pictures


def _timed(method: Method, frame: Frame, keyframe: Frame, tally: Tally) -> Estimate:
    marks = [time.perf_counter()]
    described = []
    for image in (frame, keyframe):
        described.append(method.describe(image))
        marks.append(time.perf_counter())
    estimate = method.register(*described)
    marks.append(time.perf_counter())
    first, second, last = np.diff(marks) * 1e3
    tally.describe += [first, second]
    tally.register.append(last)
    return estimate


def _images(recording: Dataset, height: int) -> torch.Tensor:
    """A few images (B, 3, h, w) spread over the recording."""
    images = [reduced(recording[int(i)], height)[0] for i in np.linspace(0, len(recording) - 1, 4)]
    return torch.from_numpy(np.stack(images)).permute(0, 3, 1, 2)


COLUMNS = (
    *((f"rotation_below_{limit}_deg", f"< {limit}° [%]", 100.0, 0) for limit in ROTATIONS),
    *((f"translation_below_{limit}_cm", f"< {limit} cm [%]", 100.0, 0) for limit in TRANSLATIONS),
    ("rotation_mean_deg", "rotation, mean [°]", 1.0, 2),
    ("rotation_median_deg", "median", 1.0, 2),
    ("translation_mean_cm", "translation, mean [cm]", 1.0, 2),
    ("translation_median_cm", "median", 1.0, 2),
    ("believed", "believed [%]", 100.0, 0),
    ("believed_but_wrong", "and wrong [%]", 100.0, 1),
    ("right_of_believed", f"of them < {_RIGHT[0]}° and < {_RIGHT[1]} cm [%]", 100.0, 1),
    ("doubted_of_not_right", "doubted of the others [%]", 100.0, 0),
    ("ms_a_frame", "ms a frame", 1.0, 0),
    ("ms_a_pair", "ms a pair", 1.0, 0),
)


def _cell(value: float | None, unit: float, digits: int) -> str:
    return "-" if value is None else f"{value * unit:.{digits}f}"


def markdown(found: Mapping[str, Any]) -> str:
    """The report as text: a table for each recording."""
    rows, m = found["rows"], found["machine"]
    parts = [f"idf-slam {m['idf-slam']}, preset {found['preset']}, {m['processor']}, {m['cores']} cores."]
    for name in dict.fromkeys(row["recording"] for row in rows):
        cells = [
            [row["method"], str(row["gap"]), str(row["pairs"]), *(_cell(row[key], unit, digits) for key, _, unit, digits in COLUMNS)]
            for row in rows
            if row["recording"] == name
        ]
        parts += [f"{name}:", markdown_table(["method", "gap", "pairs", *(title for _, title, _, _ in COLUMNS)], cells)]
    return "\n\n".join(parts) + "\n"
