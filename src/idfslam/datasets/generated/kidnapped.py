"""Kidnapping: a recording interrupted by darkness, after which the camera is somewhere it has been before.

With N frames and `times` = K, moment k = 1..K comes when frame m = round(k N / (K + 1)) - 1 has been shown for the first time.
`frames` black images without depth follow, then frame j of the recording, drawn between 20 % and 80 % of the m + 1 frames seen so
far and at another place or gaze than frame m (0.5 m or 30 degrees away, where the truth is known and such a frame exists). From j
the recording goes on, through what was seen and into what is new, until the next moment; after the last one to its end. Every
frame is shown at least once.
"""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from idfslam.datasets.recording import FPS, Dataset
from idfslam.errors import ConfigError
from idfslam.frame import Frame

if TYPE_CHECKING:
    import trimesh

BLACK = -1  # in `order`: a frame that shows nothing
_RETURN = (0.2, 0.8)  # of what was seen
_APART = 0.5, np.deg2rad(30)  # [m], [rad]

Array = NDArray[np.float64]


class Kidnapped:
    """A dataset of the frames of another one in the order `order` (M,): its indices, BLACK for a black frame.

    Time stamps are regular, at the recording's median interval. `ground_truth` follows the frames, with NaN for the black ones.
    Raises ConfigError where the recording is too short for so many kidnappings: it takes two frames more than two for each.
    """

    def __init__(self, dataset: Dataset, times: int = 5, frames: int = 30, seed: int = 0) -> None:
        if times < 1 or frames < 1 or len(dataset) < 2 * (times + 1):
            found = f"{times} kidnappings of {frames} black frames in the {len(dataset)} frames of {dataset.name}"
            raise ConfigError(f"{found}, expected at least 1 of each and {2 * (max(times, 1) + 1)} frames")
        truth = dataset.ground_truth
        self.name, self.camera, self._dataset = f"kidnap-{dataset.name}", dataset.camera, dataset
        self.order: NDArray[np.int64] = kidnapped_order(len(dataset), truth, times, frames, np.random.default_rng([seed, 29]))
        stamps = dataset.timestamps
        interval = float(np.median(np.diff(stamps))) or 1 / FPS
        self.timestamps: Array = stamps[0] + interval * np.arange(len(self.order))
        self.ground_truth: Array | None = None
        if truth is not None:
            self.ground_truth = np.where((self.order == BLACK)[:, None, None], np.nan, truth[self.order])

    def __len__(self) -> int:
        return len(self.order)

    def __getitem__(self, i: int) -> Frame:
        """Frame i, from -M to M-1; raises FrameError where the recording does."""
        i = range(len(self))[i]
        stamp = float(self.timestamps[i])
        if self.order[i] == BLACK:
            return Frame.blank(i, stamp, self.camera)
        return replace(self._dataset[int(self.order[i])], index=i, timestamp=stamp)

    def surface(self) -> "trimesh.Trimesh | None":
        """The recording's true surface, where it is known."""
        return self._dataset.surface()


def kidnapped_order(count: int, truth: Array | None, times: int, frames: int, rng: Generator) -> NDArray[np.int64]:
    """(M,) which of `count` frames is shown when, BLACK for none; `truth` (N, 4, 4) camera-to-world tells which frames differ."""
    pieces, start = [], 0
    for k in range(1, times + 1):
        last = round(k * count / (times + 1)) - 1
        pieces += [np.arange(start, last + 1), np.full(frames, BLACK)]
        low, high = (int(np.ceil(share * (last + 1))) for share in _RETURN)
        start = int(rng.choice(_elsewhere(np.arange(low, high), last, truth)))
    return np.concatenate([*pieces, np.arange(start, count)])


def _elsewhere(candidates: NDArray[np.int64], last: int, truth: Array | None) -> NDArray[np.int64]:
    """Those candidates whose pose is not that of frame `last`; all of them where none is known to differ."""
    if truth is None:
        return candidates
    far = np.linalg.norm(truth[candidates, :3, 3] - truth[last, :3, 3], axis=1) > _APART[0]
    cosine = (np.einsum("nij,ij->n", truth[candidates, :3, :3], truth[last, :3, :3]) - 1) / 2
    different = far | (cosine < np.cos(_APART[1]))  # never true of NaN
    return candidates[different] if different.any() else candidates
