"""Kidnapping, a test of relocalisation: a recording interrupted by darkness, after which the camera is at an earlier place.

With N frames and `times` = K, kidnapping k = 1..K happens after frame m = round(k N / (K + 1)) - 1 was shown for the first time.
`frames` black images without depth follow. Then the recording continues from an earlier frame j, drawn between 20 % and 80 % of the m + 1
frames seen so far, whose pose differs from that of frame m by 0.5 m or 30 degrees (if the truth is known and such a frame exists). It
continues until the next kidnapping, and after the last one to its end. Every frame is shown at least once.
"""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from idfslam.datasets.provenance import provenance
from idfslam.datasets.recording import FPS, Dataset, depth_timestamps, timing
from idfslam.errors import ConfigError
from idfslam.frame import Frame

if TYPE_CHECKING:
    import trimesh

BLACK = -1  # stands for a black frame in `order`, where others are numbers from 0: raised, it would be one of them
_RETURN = (0.2, 0.8)  # [1] range of the frames seen so far to which the camera returns; wider: nearer to the newest or the first. Chosen
#    by hand
_APART = 0.5, np.deg2rad(30)  # [m], [rad] smallest difference of the pose after darkness; raised, fewer frames qualify. Chosen by hand

Array = NDArray[np.float64]


class Kidnapped:
    """A dataset with the frames of another one in the order `order` (M,): their indices, or BLACK for a black frame.

    Time stamps are regular, at the median interval of the other dataset. `ground_truth` belongs to the frames; it is NaN for black ones.
    Raises ConfigError if the other dataset has fewer than 2 (times + 1) frames.
    """

    def __init__(self, dataset: Dataset, times: int = 5, frames: int = 30, seed: int = 0) -> None:
        if times < 1 or frames < 1 or len(dataset) < 2 * (times + 1):
            found = f"{times} kidnappings of {frames} black frames in the {len(dataset)} frames of {dataset.name}"
            raise ConfigError(f"{found}, expected at least 1 of each and {2 * (max(times, 1) + 1)} frames")
        truth = dataset.ground_truth
        self.name, self.camera, self._dataset = f"kidnap-{dataset.name}", dataset.camera, dataset
        self.provenance, self.random_access = provenance(dataset), bool(getattr(dataset, "random_access", True))
        self.order: NDArray[np.int64] = kidnapped_order(len(dataset), truth, times, frames, np.random.default_rng([seed, 29]))
        stamps = dataset.timestamps
        interval = float(np.median(np.diff(stamps))) or 1 / FPS
        self.timestamps: Array = stamps[0] + interval * np.arange(len(self.order))
        depth_stamps, self.timing = depth_timestamps(dataset), timing(dataset)
        self.depth_timestamps: Array | None = None
        if depth_stamps is not None:
            self.depth_timestamps = np.where(self.order == BLACK, np.nan, self.timestamps + (depth_stamps - stamps)[self.order])
        self.ground_truth: Array | None = None
        if truth is not None:
            self.ground_truth = np.where((self.order == BLACK)[:, None, None], np.nan, truth[self.order])

    def __len__(self) -> int:
        return len(self.order)

    def __getitem__(self, i: int) -> Frame:
        """Frame i, from -M to M-1; raises FrameError if the recording does."""
        i = range(len(self))[i]
        stamp = float(self.timestamps[i])
        if self.order[i] == BLACK:
            return Frame.blank(i, stamp, self.camera)
        frame = self._dataset[int(self.order[i])]
        return replace(frame, index=i, timestamp=stamp, depth_timestamp=stamp + frame.depth_lag)

    def surface(self) -> "trimesh.Trimesh | None":
        """The recording's true surface, if known."""
        return self._dataset.surface()


def kidnapped_order(count: int, truth: Array | None, times: int, frames: int, rng: Generator) -> NDArray[np.int64]:
    """(M,) the index of each frame to show, of `count` frames, or BLACK.

    truth: camera-to-world poses (N, 4, 4), to find frames with another view; None: unknown.
    """
    parts, start = [], 0
    for k in range(1, times + 1):
        last = round(k * count / (times + 1)) - 1
        parts += [np.arange(start, last + 1), np.full(frames, BLACK)]
        low, high = (int(np.ceil(share * (last + 1))) for share in _RETURN)
        start = int(rng.choice(_elsewhere(np.arange(low, high), last, truth)))
    return np.concatenate([*parts, np.arange(start, count)])


def _elsewhere(candidates: NDArray[np.int64], last: int, truth: Array | None) -> NDArray[np.int64]:
    """The candidates whose pose differs from that of frame `last`; all of them if none is known to differ."""
    if truth is None:
        return candidates
    far = np.linalg.norm(truth[candidates, :3, 3] - truth[last, :3, 3], axis=1) > _APART[0]
    cosine = (np.einsum("nij,ij->n", truth[candidates, :3, :3], truth[last, :3, :3]) - 1) / 2
    different = far | (cosine < np.cos(_APART[1]))  # never true of NaN
    return candidates[different] if different.any() else candidates
