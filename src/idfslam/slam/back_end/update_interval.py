"""When the map learns between keyframes: every so many frames since its last update, from a frame that may be mapped."""

from idfslam.graph.frame_poses import FramePoses
from idfslam.graph.keyframe import Keyframe
from idfslam.slam.tracked import Tracked
from idfslam.storage.state import State, Stateful


class UpdateInterval(Stateful):
    """Counts the frames since the last update of the map."""

    def __init__(self, every: int, frames: FramePoses) -> None:
        """every: frames from one update to the next; 0: keyframes alone are learnt."""
        self.every, self.frames = every, frames
        self._updated_at = 0  # number of frames at the last update

    def state(self) -> State:
        """The number of frames at the last update."""
        return {"updated_at": self._updated_at}

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        self._updated_at = state["updated_at"]

    def is_due(self, view: Keyframe, tracked: Tracked) -> bool:
        """Whether the map is to learn the last frame, which is no keyframe."""
        due = 0 < self.every <= len(self.frames) - self._updated_at
        return due and tracked.may_be_mapped and view.has_depth

    def begin(self) -> None:
        """Notes that an update begins."""
        self._updated_at = len(self.frames)
