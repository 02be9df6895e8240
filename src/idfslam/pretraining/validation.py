"""Validation during pretraining: how well the features register pairs of held-out recordings. Only here are true poses used."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from idfslam.config import PretrainConfig
from idfslam.datasets import Dataset
from idfslam.geometry import se3
from idfslam.pretraining.footage import Footage, Pair, load_footage
from idfslam.pretraining.training import explained, features_of, registered_pose
from idfslam.tracking.features import FeatureExtractor

GAPS = (5, 10, 20, 40)
_PAIRS = 12  # of each recording and gap; more: slower, less noise


@dataclass(frozen=True)
class HeldOut:
    """Pairs of a recording that is not trained on."""

    name: str
    footage: Footage  # the frames of the pairs only
    pairs: dict[int, list[tuple[int, int]]]  # by gap: places in the footage
    T_wc: NDArray[np.float64] | None  # (N, 4, 4) of the footage's frames; None without ground truth


def held_out(recording: Dataset, config: PretrainConfig) -> HeldOut:
    """Pairs evenly spread over the recording, for each gap shorter than it. Raises RecordingError for fewer than two frames."""
    starts = {gap: np.linspace(0, len(recording) - 1 - gap, _PAIRS).astype(int) for gap in GAPS if gap < len(recording)}
    frames = sorted({int(i) for gap, first in starts.items() for i in (*first, *(first + gap))})
    place = {frame: i for i, frame in enumerate(frames)}
    pairs = {gap: [(place[int(i)], place[int(i) + gap]) for i in first] for gap, first in starts.items()}
    truth = recording.ground_truth
    return HeldOut(recording.name, load_footage(recording, config.height, frames), pairs, None if truth is None else truth[frames])


@torch.no_grad()
def validate(extractor: FeatureExtractor, recordings: Sequence[HeldOut], config: PretrainConfig) -> dict[str, float]:
    """Registers the pairs of all recordings. Returns values named NAME/MEASURE-GAP.

    Measures: the share of pairs whose pose agrees with both depth images and, with ground truth, the share with errors below 5 degrees and
    10 cm and the medians of both errors [degrees, cm]. A pair that cannot be registered counts with the identity as its pose.
    """
    training = extractor.training
    extractor.eval()
    figures: dict[str, float] = {}
    for held in recordings:
        for gap, places in held.pairs.items():
            found = [_registered(extractor, Pair(held.footage.whole(i), held.footage.whole(j)), config) for i, j in places]
            figures[f"{held.name}/explained-{gap}"] = float(np.mean([ok for _, ok in found]))
            if held.T_wc is not None:
                truth = [np.linalg.inv(held.T_wc[i]) @ held.T_wc[j] for i, j in places]
                errors = np.array([pose_error(T, t) for (T, _), t in zip(found, truth) if np.isfinite(t).all()]).reshape(-1, 2)
                figures |= _errors(held.name, gap, errors) if len(errors) else {}
    extractor.train(training)
    return figures


def pose_error(T: NDArray[np.float64], truth: NDArray[np.float64]) -> tuple[float, float]:
    """Rotation [degrees] and translation [cm] between two transforms (4, 4)."""
    delta = np.linalg.inv(truth) @ T
    return float(torch.rad2deg(se3.angle(torch.from_numpy(delta)))), float(np.linalg.norm(delta[:3, 3]) * 100)


def _registered(extractor: FeatureExtractor, pair: Pair, config: PretrainConfig) -> tuple[NDArray[np.float64], bool]:
    pair = pair.to(next(extractor.parameters()).device)
    a, b = features_of(extractor, [pair.a.colour, pair.b.colour], config)
    T_ab = registered_pose(a, b, pair, config, torch.Generator().manual_seed(config.seed))
    return (np.eye(4), False) if T_ab is None else (T_ab.cpu().numpy(), explained(T_ab, pair, config) is not None)


def _errors(name: str, gap: int, errors: NDArray[np.float64]) -> dict[str, float]:
    rotation, translation = np.median(errors, 0)
    within = float(((errors[:, 0] < 5) & (errors[:, 1] < 10)).mean())
    return {f"{name}/within-{gap}": within, f"{name}/rotation-{gap}": float(rotation), f"{name}/translation-{gap}": float(translation)}
