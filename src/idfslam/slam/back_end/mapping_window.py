"""The window of a joint optimisation: the current frame, the last keyframe, and keyframes that are chosen by loss or by overlap."""

from abc import abstractmethod
from collections.abc import Callable, Sequence

import torch

from idfslam.config import JointMappingConfig
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.graph.ray_overlap import ray_overlap
from idfslam.storage.state import State, Stateful


class MappingWindow(Stateful):
    """Draws windows. Chance comes from a generator that is shared, and kept by its owner."""

    def __init__(self, config: JointMappingConfig, graph: KeyframeGraph, generator: torch.Generator) -> None:
        self.config, self.graph, self.generator = config, graph, generator

    def state(self) -> State:
        """The generator."""
        return {"generator": self.generator.get_state()}

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        self.generator.set_state(state["generator"])

    def around(self, view: Keyframe, *, wider: int = 1) -> Callable[[], list[Keyframe]]:
        """A function that draws a window around a frame, which is its last one. wider: factor on the size."""
        last, chosen = self._last(view), wider * self.config.window - 2
        draw = self._chooser(view, [k for k in self.graph.keyframes if k is not view and k is not last], max(chosen, 0))
        return lambda: [*draw(), *([last] if last is not None else []), view]

    def _last(self, view: Keyframe) -> Keyframe | None:
        """The last keyframe before a frame."""
        return next((k for k in reversed(self.graph.keyframes) if k is not view), None)

    @abstractmethod
    def _chooser(self, view: Keyframe, candidates: Sequence[Keyframe], count: int) -> Callable[[], list[Keyframe]]:
        """A function that chooses at most `count` keyframes each time."""


class LossWindow(MappingWindow):
    """Keyframes in proportion to their loss when they last took part, anew at each step (iMAP, Sec. 3.5)."""

    def __init__(
        self, config: JointMappingConfig, graph: KeyframeGraph, generator: torch.Generator, loss_of: Callable[[Keyframe], float]
    ) -> None:
        super().__init__(config, graph, generator)
        self._loss_of = loss_of

    def _chooser(self, view: Keyframe, candidates: Sequence[Keyframe], count: int) -> Callable[[], list[Keyframe]]:
        def choose() -> list[Keyframe]:
            if len(candidates) <= count or not count:
                return list(candidates[:count])
            losses = torch.tensor([self._loss_of(keyframe) for keyframe in candidates]).clamp(min=1e-6)
            return [candidates[i] for i in torch.multinomial(losses, count, generator=self.generator).tolist()]

        return choose


class OverlapWindow(MappingWindow):
    """Random keyframes among those that have some of the frame's surroundings in sight, one choice for an update (NICE-SLAM, Sec. 3.3)."""

    def _chooser(self, view: Keyframe, candidates: Sequence[Keyframe], count: int) -> Callable[[], list[Keyframe]]:
        shares = ray_overlap(view, candidates, self.generator)
        overlapping = [keyframe for keyframe, share in zip(candidates, shares) if share > 0]
        order = torch.randperm(len(overlapping), generator=self.generator)[:count].tolist()
        chosen = [overlapping[i] for i in order]
        return lambda: chosen
