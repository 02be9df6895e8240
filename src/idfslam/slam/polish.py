"""The polish at the end of a run: all keyframes and the map in turns, in steps that shrink to nothing."""

import math
from time import perf_counter

from idfslam.config import MapperConfig
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.graph.replay import Replay
from idfslam.mapping.mapper import Mapper
from idfslam.slam.refinement import NoRefinement
from idfslam.slam.relearn_queue import RelearnQueue


class NoPolish:
    """The map stays as it is after the last frame, as in the paper."""

    def run(self) -> bool:
        """Whether there was anything to do."""
        return False


class Polish(NoPolish):
    """Refines random keyframes, then updates the map on them, within a budget of time."""

    def __init__(
        self, config: MapperConfig, graph: KeyframeGraph, replay: Replay, relearn: RelearnQueue, refinement: NoRefinement, mapper: Mapper
    ) -> None:
        self.config, self.graph, self.replay, self.relearn, self.refinement, self.mapper = (
            config,
            graph,
            replay,
            relearn,
            refinement,
            mapper,
        )

    def run(self) -> bool:
        c, start = self.config, perf_counter()
        refined = max(1, c.final_keyframes // 2)
        updates = max(c.final_updates, math.ceil(c.final_rounds * len(self.graph.keyframes) / refined))
        for i in range(updates):
            spent = (perf_counter() - start) / c.final_seconds
            done = i / updates if spent < (i + 1) / updates else spent  # the clock counts only where time runs short: repeatable elsewhere
            if done >= 1:
                break
            keyframes = self.replay.sample(c.final_keyframes)
            self.refinement.refine(keyframes[:refined])
            self.relearn.trained(keyframes)
            self.mapper.start_update(keyframes, c.iterations, anneal=1 - done)
        self.mapper.finish()
        return True
