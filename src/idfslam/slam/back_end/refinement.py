"""Refinement: stored keyframes are aligned to the present map again, in turns with updates of the map on the same keyframes.

It alternates and is not a joint bundle adjustment: one keyframe moves at a time, while the map is frozen.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence

from idfslam.alignment.aligner import MapAligner
from idfslam.alignment.motion import change_between, moved
from idfslam.config import RefinementConfig
from idfslam.frame import Status
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.slam.back_end.relearn_queue import RelearnQueue


class Refinement(ABC):
    """Refines stored keyframes."""

    @abstractmethod
    def refine(self, keyframes: Sequence[Keyframe]) -> None:
        """Refines the poses of stored keyframes."""


class NoRefinement(Refinement):
    """No refinement, as in the paper."""

    def refine(self, keyframes: Sequence[Keyframe]) -> None: ...


class KeyframeRefinement(Refinement):
    """Aligns keyframes to the map and to the images of older keyframes."""

    def __init__(
        self,
        config: RefinementConfig,
        graph: KeyframeGraph,
        relearn: RelearnQueue,
        aligner: MapAligner,
        held: Callable[[Keyframe], bool] = lambda keyframe: False,
        *,
        references: int,
    ) -> None:
        """held: whether something more exact than the map holds a keyframe, which then stays. references: keyframes it is compared with."""
        self.references = references
        self.held, self.config, self.graph, self.relearn, self.aligner = held, config, graph, relearn, aligner

    def refine(self, keyframes: Sequence[Keyframe]) -> None:
        """Refines the poses of stored keyframes, except the first of each submap, which defines its world.

        Keyframes that were registered in wide steps are left out: the map there was learnt from few views. So are those that a loop has
        moved, until the map has learnt them again: it would draw them back.
        """
        for keyframe in keyframes:
            if keyframe.host != keyframe.submap and not keyframe.registered and not self.held(keyframe) and keyframe not in self.relearn:
                self._refine(keyframe)

    def _refine(self, keyframe: Keyframe) -> None:
        references = self.graph.older_references(keyframe, self.references)
        aligned = self.aligner.align(keyframe, keyframe.T_wk, references, max_guess_error_px=0.0)
        change = change_between(keyframe.T_wk, aligned.T_wc)
        small = float(change[:3].norm()) < self.config.max_shift
        if aligned.status is Status.OK and small and not self.aligner.is_doubtful(aligned):
            # Half of the change: the map has learnt this place partly from the present pose.
            self.graph.set_pose(keyframe, moved(keyframe.T_wk, change / 2))
        self.aligner.appearances.release(keyframe)
