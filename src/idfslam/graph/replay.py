"""Replay (Sec. IV-C): stored keyframes that the map trains on besides the newest one, so that it does not forget other places."""

from collections.abc import Sequence

import torch

from idfslam.config import KeyframeConfig
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.storage.state import State, Stateful


class Replay(Stateful):
    """Draws stored keyframes at random."""

    def __init__(self, config: KeyframeConfig, graph: KeyframeGraph, generator: torch.Generator) -> None:
        self.config, self.graph, self._generator = config, graph, generator

    def state(self) -> State:
        """The generator."""
        return {"generator": self._generator.get_state()}

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        self._generator.set_state(state["generator"])

    @property
    def count(self) -> int:
        """The largest number of keyframes drawn for one update."""
        return self.config.replay + self.config.replay_connected

    def draw(self, keyframe: Keyframe) -> list[Keyframe]:
        """At most N_rep random stored keyframes that are not covisible with `keyframe` (Sec. IV-C).

        Beyond the paper, `replay_connected` random covisible ones are added. With them the map averages many views of the same surface.
        """
        separate: list[Keyframe] = []
        connected: list[Keyframe] = []
        for i, other in enumerate(self.graph.keyframes):
            if other is not keyframe:
                (connected if i in keyframe.covisible else separate).append(other)
        return self._random(separate, self.config.replay) + self._random(connected, self.config.replay_connected)

    def sample(self, count: int) -> list[Keyframe]:
        """`count` random stored keyframes, or all if there are fewer."""
        return self._random(self.graph.keyframes, count)

    def _random(self, keyframes: Sequence[Keyframe], count: int) -> list[Keyframe]:
        chosen = torch.randperm(len(keyframes), generator=self._generator)[:count]
        return [keyframes[i] for i in chosen.tolist()]
