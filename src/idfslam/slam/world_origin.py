"""The frame that defines the world: the first whose depth later frames can be aligned to.

Where only a floor or the edge of a table is within the sensor's reach, a map of it confirms no pose, and the camera is lost at once. So the
world waits for a frame with more depth, which comes when the camera is raised or moves closer. A recording of an object without background
never has such a frame: after `_PATIENCE` frames one with little depth begins the map. If a frame with more depth comes later, and the map
cannot locate it, a new submap begins (`recovery.Relocalisation`). Little depth with a black image is a covered lens, and begins nothing.
"""

from idfslam.graph.keyframe import Keyframe
from idfslam.slam.tracked import Tracked
from idfslam.storage.state import State, Stateful

# [1] Share of the cells of an image with a reading from which it defines the world at once. More: places that are mostly out of reach are
# mapped later. Less: lost in them. Chosen by hand: a room beyond a Kinect's reach that is tracked well from its first frame on has 0.19.
_ENOUGH = 0.15
_PATIENCE = 30  # frames with less depth, after which one of them does it. More: objects without a background are mapped later


def may_define_world(view: Keyframe) -> bool:
    """Whether a view has enough depth for later ones to be aligned to it."""
    return view.depth_share >= _ENOUGH


class WorldOrigin(Stateful):
    """Waits for the frame that defines the world."""

    def __init__(self) -> None:
        self._waited = 0  # frames that show something, with depth, but less than enough

    def state(self) -> State:
        """How many frames it has waited for."""
        return {"waited": self._waited}

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        self._waited = state["waited"]

    def track(self, view: Keyframe) -> Tracked:
        """The result for a view before there is a map: it defines the world, or is lost."""
        shows_little = view.has_depth and not view.is_clipped
        defines = may_define_world(view) or (shows_little and self._waited >= _PATIENCE)
        self._waited += shows_little and not defines
        return Tracked.first(view.T_wk, defines_world=defines)
