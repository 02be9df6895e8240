"""The polish at the end of a run: the keyframes are adjusted, and the map is trained with learning rates that decay to zero.

Where the keyframes could not be adjusted together, they are refined one at a time, in turns with the map.
"""

import math
from abc import ABC, abstractmethod
from time import perf_counter

from idfslam.config import RefinementConfig
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.graph.replay import Replay
from idfslam.mapping.mapper import Mapper
from idfslam.slam.back_end.refinement import NoRefinement, Refinement
from idfslam.slam.back_end.relearn_queue import RelearnQueue
from idfslam.slam.keyframe_adjustment.global_adjustment import KeyframeAdjustment


class Polishing(ABC):
    """Improves keyframes and map at the end of a run."""

    @abstractmethod
    def run(self) -> None:
        """Called once, after the last frame."""


class NoPolish(Polishing):
    """No polish, as in the paper."""

    def run(self) -> None: ...


class Polish(Polishing):
    """Adjusts the keyframes, then updates the map on random ones, within a time budget."""

    def __init__(
        self,
        config: RefinementConfig,
        steps: int,
        graph: KeyframeGraph,
        replay: Replay,
        relearn: RelearnQueue,
        adjustment: KeyframeAdjustment,
        refinement: Refinement,
        mapper: Mapper,
    ) -> None:
        """steps: number of steps of each map update."""
        self.config, self.steps, self.graph, self.replay = config, steps, graph, replay
        self.relearn, self.adjustment, self.refinement, self.mapper = relearn, adjustment, refinement, mapper

    def run(self) -> None:
        c, begun = self.config, perf_counter()
        refinement = NoRefinement() if self.adjustment.run() else self.refinement
        start = perf_counter()
        left = max(c.seconds - (start - begun), 1e-9)
        refined = max(1, c.keyframes // 2)
        updates = max(c.updates, math.ceil(c.rounds * len(self.graph.keyframes) / refined))
        for i in range(updates):
            spent = (perf_counter() - start) / left
            # The clock matters only if time runs short. Otherwise runs repeat exactly.
            done = i / updates if spent < (i + 1) / updates else spent
            if done >= 1:
                break
            keyframes = self.replay.sample(c.keyframes)
            refinement.refine(keyframes[:refined])
            self.relearn.trained(keyframes)
            self.mapper.start_update(keyframes, self.steps, anneal=1 - done, cores=1.0)  # no frame waits for them
        self.mapper.finish()
