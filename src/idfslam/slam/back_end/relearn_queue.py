"""The queue of keyframes that have moved and that the map must learn again at their new poses."""

from collections.abc import Iterable

from idfslam.graph.keyframe import Keyframe
from idfslam.storage.frame_memory import FrameMemory
from idfslam.storage.state import State, Stateful


class RelearnQueue(Stateful):
    """For each moved keyframe, the number of map updates that must still train on it instead of a random one."""

    def __init__(self, updates: int) -> None:
        """updates: number for a keyframe that has moved. More: the map follows more surely, and replays nothing else for longer."""
        self.updates = updates
        self._left: FrameMemory[int] = FrameMemory()

    def state(self) -> State:
        """The numbers of updates left."""
        return self._left.state()

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        self._left.restore(state)

    def __contains__(self, keyframe: Keyframe) -> bool:
        return self._left.get(keyframe) is not None

    def add(self, keyframes: Iterable[Keyframe]) -> None:
        """Adds keyframes that have moved."""
        for keyframe in keyframes:
            self._left[keyframe] = self.updates

    def trained(self, keyframes: Iterable[Keyframe]) -> None:
        """Counts a map update on keyframes."""
        for keyframe in keyframes:
            left = (self._left.get(keyframe) or 0) - 1
            if left > 0:
                self._left[keyframe] = left
            else:
                self._left.forget(keyframe)

    def nearest(self, keyframe: Keyframe, keyframes: Iterable[Keyframe], count: int) -> list[Keyframe]:
        """Up to `count` of `keyframes` that are in the queue, those nearest to `keyframe` first."""
        waiting = [k for k in keyframes if k in self and k is not keyframe]
        waiting.sort(key=lambda k: float((k.T_wk - keyframe.T_wk)[:3, 3].norm()))
        return waiting[:count]
