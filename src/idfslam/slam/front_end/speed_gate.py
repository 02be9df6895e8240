"""A gate on speed: a camera that a hand carries does not leap.

Where a pattern repeats, as on a wall or a shelf, the image fits one period beside the true pose, and patches confirm it there. What the
images cannot tell apart, the motion can: a period of 30 cm from one frame to the next is 10 m/s. A camera that a vehicle carries becomes as
fast, but from frame to frame its velocity changes little.
"""

import torch
from torch import Tensor

from idfslam.alignment.continuous_motion import is_of_a_hand
from idfslam.alignment.frame_interval import FrameInterval
from idfslam.alignment.motion import change_between
from idfslam.graph.frame_poses import FramePoses
from idfslam.slam.tracked import Tracked
from idfslam.storage.state import State, Stateful

# [frames] with poses in a row, none of which was faster than a hand, after which one that is faster is a leap. More: photographs that are
# stamped as a video's pass for one less often, and leaps at the beginning of a recording are not told. Chosen by hand
_CARRIED = 10


class SpeedGate(Stateful):
    """Says whether a pose is out of a hand's reach from the last frame that was trusted."""

    def __init__(self, frames: FramePoses) -> None:
        self._frames = frames
        self._last: tuple[int, float] | None = None  # number and stamp [s] of the last frame whose pose was trusted; None: there is none
        self._stamp: float | None = None  # [s] of the frame before
        self.interval = FrameInterval()
        self._velocity = torch.zeros(6, dtype=torch.float64)  # [m/s], [rad/s] with which it got there
        self._carried = 0  # frames in a row to which the motion was a hand's

    def state(self) -> State:
        """The last trusted frame and its velocity, the stamps' intervals, and for how long the motion has been a hand's."""
        last, known = None if self._last is None else list(self._last), {"stamp": self._stamp, "carried": self._carried}
        return {"last": last, "velocity": self._velocity.tolist(), "intervals": self.interval.recent(), **known}

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        self._last = None if state["last"] is None else (state["last"][0], state["last"][1])
        self._stamp, self._carried = state["stamp"], state["carried"]
        self._velocity = torch.tensor(state["velocity"], dtype=torch.float64)
        self.interval = FrameInterval(state["intervals"])

    def is_leap(self, timestamp: float, T_wc: Tensor) -> bool:
        """Whether a camera that was carried by a hand until the last trusted frame cannot be at this pose (4, 4) at this time [s].

        Neither its velocity since then nor the change of its velocity is a hand's.
        """
        if self._carried < _CARRIED:
            return False
        velocity = self._velocity_to(timestamp, T_wc)
        return not (is_of_a_hand(velocity.numpy()) or is_of_a_hand((velocity - self._velocity).numpy()))

    def accept(self, index: int, timestamp: float, tracked: Tracked) -> None:
        """Takes over the result for the frame of this number and time [s].

        Doubtful frames are passed over. After a lost one the camera may be anywhere.
        """
        if self._stamp is not None:
            self.interval.add(timestamp - self._stamp)
        self._stamp = timestamp
        if tracked.is_lost or not tracked.continues_motion:
            self._last, self._carried = None, 0
        elif tracked.status.trusted:
            self._velocity = self._velocity_to(timestamp, tracked.T_wc)
            self._carried = self._carried + 1 if is_of_a_hand(self._velocity.numpy()) else 0
            self._last = index, timestamp

    def _velocity_to(self, timestamp: float, T_wc: Tensor) -> Tensor:
        """The mean velocity (6,) [m/s], [rad/s] since the last trusted frame; 0 without one."""
        if self._last is None:
            return torch.zeros(6, dtype=torch.float64)
        index, stamp = self._last
        return change_between(self._frames.T_wc(index), T_wc) / self.interval.in_whole_frames(timestamp - stamp)
