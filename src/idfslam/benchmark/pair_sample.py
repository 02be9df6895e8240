"""Pairs of frames of a recording, some frames apart, with their true relative poses."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from idfslam.datasets import Dataset
from idfslam.errors import FrameError, RecordingError
from idfslam.frame import Frame


@dataclass(frozen=True)
class PairSample:
    """Pairs of frames of a recording, `gap` apart, both with true poses. Pairs that are unreadable or without depth are skipped."""

    recording: Dataset
    gap: int
    starts: tuple[int, ...]

    def __iter__(self) -> Iterator[tuple[Frame, Frame, NDArray[np.float64]]]:
        """(keyframe, frame, true T_kc) of each."""
        truth = self.recording.ground_truth
        assert truth is not None
        for i in self.starts:
            try:
                keyframe, frame = self.recording[i], self.recording[i + self.gap]
            except FrameError:
                continue
            if not (keyframe.depth.any() and frame.depth.any()):
                continue
            yield keyframe, frame, np.linalg.inv(truth[i]) @ truth[i + self.gap]


def sample(recording: Dataset, gap: int, pairs: int) -> PairSample:
    """`pairs` pairs evenly spread over the recording. Raises RecordingError if it has no poses or is too short."""
    truth = recording.ground_truth
    if truth is None:
        raise RecordingError(f"{recording.name}: has no ground truth, expected poses to compare with; choose a recording that has them")
    if len(recording) <= gap:
        raise RecordingError(f"{recording.name}: has {len(recording)} frames, expected more than --gap {gap}")
    known = np.asarray(np.isfinite(truth).all((1, 2)))
    starts = np.flatnonzero(known[:-gap] & known[gap:])
    if not len(starts):
        raise RecordingError(f"{recording.name}: no two frames {gap} apart have poses; choose another --gap")
    chosen = starts[np.unique(np.linspace(0, len(starts) - 1, pairs).astype(int))]
    return PairSample(recording, gap, tuple(int(i) for i in chosen))
