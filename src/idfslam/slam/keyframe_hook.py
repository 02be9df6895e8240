"""What happens at each new keyframe beside mapping: loops, merged submaps, doubts about a relocalisation. Each is one class."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from idfslam.graph.keyframe import Keyframe
from idfslam.graph.loop_consistency import Loop
from idfslam.storage.state import Stateful


@dataclass(frozen=True)
class Moved:
    """Keyframes that the map has to learn again."""

    keyframes: Sequence[Keyframe] = ()
    submap: bool = False  # a whole submap has moved, the newest keyframe with it: the map must follow before the next frame
    split: bool = False  # it was split off: what other hooks know of its place is wrong


class KeyframeHook(Stateful, ABC):
    """Called with each keyframe, in the order of `compose.py`, until one moves a whole submap."""

    @abstractmethod
    def on_keyframe(self, keyframe: Keyframe) -> Moved:
        """After the keyframe was inserted into the graph, and before the map learns it."""

    def on_split(self) -> None:
        """A submap was split off because a relocalisation was wrong."""

    def closed_loops(self) -> Sequence[Loop]:
        """The loops that stand."""
        return ()

    def figures(self) -> dict[str, Any]:
        """Counts for metrics.json."""
        return {}
