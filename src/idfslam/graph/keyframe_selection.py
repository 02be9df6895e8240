"""Selection of keyframes (Sec. III): frames that moved or turned enough, and frames that see too little of their references.

A blurred frame is passed over for a sharp one soon after it, as long as enough of the references is in view.
"""

import math

from idfslam.config import KeyframeConfig
from idfslam.frame import Status
from idfslam.geometry import se3
from idfslam.graph.frame_poses import FramePoses
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.sensing.sharpness import Sharpness
from idfslam.storage.state import State, Stateful

# [rad] Motion of the image from frame to frame, or against its prediction, from which a step is wide: the next frame may be anywhere, so
# this one becomes a keyframe at once, and a registration may overrule the map. It is a tenth of a usual image's width. More: lower frame
# rates pass for usual ones. Chosen by hand on generated rooms and corridors, of which every 10th to 20th frame was taken.
WIDE = 0.12
_PATIENCE = 5  # [frames] that a blurred keyframe is put off at most; more: keyframes are sharper and farther apart. Chosen by hand


class KeyframeSelection(Stateful):
    """Decides for each tracked frame whether it becomes a keyframe."""

    def __init__(self, config: KeyframeConfig, graph: KeyframeGraph, frames: FramePoses, *, lost_frames: bool) -> None:
        """lost_frames: whether lost frames become keyframes (Sec. III). They do not if a lost camera is relocalised instead."""
        self.config, self.graph, self.frames, self.lost_frames = config, graph, frames, lost_frames
        self._last_at = 0  # number of frames at the last selection
        self.sharpness = Sharpness()
        self._put_off = 0  # number of blurred frames in a row that were passed over

    def state(self) -> State:
        """The number of frames at the last selection, and of those passed over since."""
        return {"last_at": self._last_at, "put_off": self._put_off}

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        self._last_at, self._put_off = state["last_at"], state["put_off"]

    def selects(self, view: Keyframe, status: Status, in_view: float = 1.0, step: float = 0.0, *, clear: bool = True) -> bool:
        """Whether the frame appended last becomes a keyframe. A frame without depth or colour of its own, or in doubt, never does.

        in_view: the share of the references' landmarks that the frame sees. step: see `Evidence`.
        clear: whether its brightness is about as usual. If not, a frame may be blurred or bent. One that is sharp and of one moment is
        neither, only of another place: it becomes a keyframe all the same.
        """
        blurred = self._is_blurred(view)
        unfit = self.graph.lacks_colour(view) or (not clear and (blurred or not view.taken.frame.synchronised))
        if not view.has_depth or unfit or status is Status.DOUBTFUL or (status is Status.LOST and not self.lost_frames):
            return False
        wide = step > WIDE
        if not wide and not self._is_needed(view, status, in_view):
            return False
        if blurred and not wide and self._can_wait(status, in_view):
            self._put_off += 1
            return False
        self._last_at, self._put_off = len(self.frames), 0
        return True

    def _can_wait(self, status: Status, in_view: float) -> bool:
        """Whether the next frames can be tracked without this keyframe."""
        begins = self.graph.last_keyframe is None or self.graph.awaits_first_unverified
        return status is Status.OK and not begins and in_view >= self.config.in_view and self._put_off < _PATIENCE

    def _is_blurred(self, view: Keyframe) -> bool:
        """Whether a frame is markedly less sharp than those before it."""
        return self.config.least_sharpness > 0 and self.sharpness.of_next(view.taken.frame.colour) < self.config.least_sharpness

    def _is_needed(self, view: Keyframe, status: Status, in_view: float) -> bool:
        last = self.graph.last_keyframe
        if last is None or status is Status.LOST or self.graph.awaits_first_unverified:
            return True
        if in_view < self.config.in_view and len(self.frames) - self._last_at > self.config.in_view_every:
            return True
        T_kc = se3.inverse(last.T_wk) @ view.T_wk
        shift, turn = float(T_kc[:3, 3].norm()), math.degrees(float(se3.angle(T_kc)))
        return shift > self.config.translation or turn > self.config.rotation
