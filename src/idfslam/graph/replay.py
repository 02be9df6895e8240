"""Replay (Sec. IV-C): which stored keyframes the map trains on beside the newest, so that it does not forget what lies elsewhere."""

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
        """The most keyframes that are drawn for one update."""
        return self.config.replay + self.config.replay_connected

    def draw(self, keyframe: Keyframe) -> list[Keyframe]:
        """At most N_rep random stored keyframes that are not connected to `keyframe` (Sec. IV-C).

        Beyond the paper, `replay_connected` random ones that are: they keep the shared view an average of many.
        """
        separate: list[Keyframe] = []
        connected: list[Keyframe] = []
        for i, other in enumerate(self.graph.keyframes):
            if other is not keyframe:
                (connected if i in keyframe.covisible else separate).append(other)
        return self._random(separate, self.config.replay) + self._random(connected, self.config.replay_connected)

    def sample(self, count: int) -> list[Keyframe]:
        """`count` stored keyframes at random, or all if they are fewer."""
        return self._random(self.graph.keyframes, count)

    def _random(self, keyframes: Sequence[Keyframe], count: int) -> list[Keyframe]:
        chosen = torch.randperm(len(keyframes), generator=self._generator)[:count]
        return [keyframes[i] for i in chosen.tolist()]
