"""Hooks for each new keyframe, one class each: exposures, the relocalisation check, local adjustment, loops, submaps, the camera check."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from idfslam.graph.keyframe import Keyframe
from idfslam.graph.loop_consistency import Loop
from idfslam.storage.state import Stateful

# [m] Least shift of a point 2 m before a keyframe for the map to learn it again. More: less replay, more double surfaces. Chosen by hand
RELEARN_SHIFT = 0.005


@dataclass(frozen=True)
class Moved:
    """Keyframes that have moved, which the map must learn again."""

    keyframes: Sequence[Keyframe] = ()
    at_once: bool = False  # the map must learn those around the newest keyframe before the next frame
    submap: bool = False  # a whole submap has moved, with the newest keyframe: as at_once, and no other hook is called
    split: bool = False  # the submap was split off: other hooks must forget where it was thought to be


class KeyframeHook(Stateful, ABC):
    """Called with each keyframe, in the order of `compose.py`, until one moves a whole submap."""

    @abstractmethod
    def on_keyframe(self, keyframe: Keyframe) -> Moved:
        """Called after the keyframe was inserted into the graph, before the map learns it; returns which keyframes have moved."""

    def on_split(self) -> None:
        """Called after a submap was split off because a relocalisation was wrong."""

    def on_finish(self) -> None:
        """Called after the last frame, when the keyframes' poses are final."""

    def settle(self) -> None:
        """Waits for what `on_finish` has left running beside the end of the run."""

    def closed_loops(self) -> Sequence[Loop]:
        """The closed loops."""
        return ()

    def figures(self) -> dict[str, Any]:
        """Counts for metrics.json."""
        return {}
