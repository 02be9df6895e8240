"""Smoothing: the frames after a frame tell of its pose too, once they are known.

While a run goes on, a frame's velocity is known from its own rows and the frames before it (`continuous_motion.py`). Where a hand shakes,
that is little, and an error of the velocity is one of the pose. This is the backward pass of Rauch, Tung and Striebel, "Maximum likelihood
estimates of linear dynamic systems" (AIAA Journal 3(8), 1965).
"""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from idfslam.alignment.acceleration_noise import Passage
from idfslam.alignment.continuous_motion import Filtered
from idfslam.alignment.motion import change_between, moved
from idfslam.graph.frame_poses import FramePoses
from idfslam.storage.state import State, Stateful

Array = NDArray[np.float64]


class MotionSmoother(Stateful):
    """Keeps what the filter told of each frame, and smooths the frames' poses at the end of a run."""

    def __init__(self) -> None:
        self._filtered: dict[int, Filtered] = {}  # by index of the frame

    def state(self) -> State:
        """The frames, column by column. A passage that is not known has no time."""
        kept = list(self._filtered.values())
        passages = [k.passage or Passage(0.0, np.zeros(2)) for k in kept]
        return {
            "frames": list(self._filtered),
            "R_wc": torch.from_numpy(np.reshape([k.R_wc for k in kept], (-1, 3, 3))),
            "velocity": torch.from_numpy(np.reshape([k.velocity for k in kept], (-1, 6))),
            "covariance": torch.from_numpy(np.reshape([k.covariance for k in kept], (-1, 12, 12))),
            "elapsed": [passage.elapsed for passage in passages],
            "deviation": torch.from_numpy(np.reshape([passage.deviation for passage in passages], (-1, 2))),
        }

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        columns = [state[name].numpy().copy() for name in ("R_wc", "velocity", "covariance", "deviation")]
        self._filtered = {
            i: Filtered(R_wc, velocity, covariance, Passage(elapsed, deviation) if elapsed else None)
            for i, elapsed, R_wc, velocity, covariance, deviation in zip(state["frames"], state["elapsed"], *columns)
        }

    def add(self, frame: int, filtered: Filtered) -> None:
        """Keeps what the filter tells of the frame of this index."""
        self._filtered[frame] = filtered

    def smooth(self, frames: FramePoses) -> None:
        """Smooths the poses of frames, from the last to the first, each by the one after it. Refined poses, as of keyframes, stay."""
        after: _Smoothed | None = None
        for i in sorted(self._filtered, reverse=True):
            kept, T_wc = self._filtered[i], frames.T_wc(i)
            velocity = _turned(kept, T_wc)
            if after is not None and after.frame == i + 1 and after.passage is not None:
                correction = _gain(kept.covariance, after.passage) @ after.surprise(T_wc, velocity, after.passage.elapsed)
                velocity = velocity + correction[6:]
                if not frames.is_refined(i):
                    T_wc = moved(T_wc, torch.from_numpy(correction[:6]))
                    frames.move(i, T_wc)
            after = _Smoothed(i, T_wc, velocity, kept.passage)


@dataclass(frozen=True)
class _Smoothed:
    """What all frames tell of one."""

    frame: int
    T_wc: Tensor  # (4, 4)
    velocity: Array  # (6,)
    passage: Passage | None  # from the frame before

    def surprise(self, T_before: Tensor, velocity: Array, elapsed: float) -> Array:
        """(12,) the difference of pose and velocity from a constant velocity (6,) since the pose before (4, 4)."""
        return np.concatenate([change_between(T_before, self.T_wc).numpy() - elapsed * velocity, self.velocity - velocity])


def _turned(kept: Filtered, T_wc: Tensor) -> Array:
    """The velocity (6,) along the axes of the present world: loops and refined keyframes have turned the frame to `T_wc` (4, 4) since."""
    R = T_wc[:3, :3].numpy() @ kept.R_wc.T
    return np.concatenate([R @ kept.velocity[:3], R @ kept.velocity[3:]])


def _gain(covariance: Array, passage: Passage) -> Array:
    """(12, 12) how much of the next frame's surprise is an error of this one, with a covariance (12, 12)."""
    return np.asarray(np.linalg.solve(passage.predicted(covariance), passage.transition @ covariance).T)
