"""Bundle adjustment in turns: keyframes' poses against the map as it has become since, then the map against all of them."""

import math
from collections.abc import Sequence
from time import perf_counter

from idfslam.alignment.aligner import Aligner
from idfslam.alignment.motion import change_between, moved
from idfslam.config import Config
from idfslam.frame import Status
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.mapping.mapper import Mapper
from idfslam.slam.relocaliser import Localiser

_FIRM = 2.0  # of `registration_prior_information`: with so much of its own a pose follows a registered one by 6 % of the way


class BundleAdjustment:
    """Refines keyframes of a graph together with the map."""

    def __init__(self, config: Config, graph: KeyframeGraph, mapper: Mapper, aligner: Aligner, localiser: Localiser) -> None:
        self.config, self.graph, self.mapper, self.aligner, self.localiser = config, graph, mapper, aligner, localiser

    def register(self, keyframe: Keyframe, known: float) -> None:
        """A new keyframe's pose and the neural tracker's, which knows best where the map is bare or noisy and images are few.

        It counts only where the images of the two keyframes agree with it. known: information of the pose in any direction, per unit
        weight; where that is far above `registration_prior_information` the tracker could not move it by a millimetre, and is not asked.
        """
        reference = self.graph.reference
        if reference is None or known >= _FIRM * self.config.alignment.registration_prior_information:
            return
        T_wc = self.localiser.registered(keyframe, reference)
        if T_wc is None or not self.localiser.agrees(keyframe, reference, T_wc):
            return
        aligned = self.aligner.align(keyframe, T_wc, self.graph.references(self.localiser.references), registered=True)
        if aligned.status is not Status.LOST:
            keyframe.T_wk = aligned.T_wc

    def refine(self, keyframes: Sequence[Keyframe]) -> None:
        """Keyframes' poses against the map and earlier keyframes' images. The first of a piece stays: it is the world there.

        So do those that a loop has moved until the map has followed: it would draw them back.
        """
        for keyframe in keyframes if self.config.front_end == "alignment" else []:
            if keyframe.anchor == keyframe.piece or keyframe.unlearnt:
                continue
            references = self.graph.earlier(keyframe, self.config.alignment.references)
            aligned = self.aligner.align(keyframe, keyframe.T_wk, references, within=0.0)
            change = change_between(keyframe.T_wk, aligned.T_wc)
            near = float(change[:3].norm()) < self.config.refinement.max_shift
            if aligned.status is Status.OK and near and not self.aligner.doubtful(aligned):
                keyframe.T_wk = moved(keyframe.T_wk, change / 2)  # half way: what the map knows here it has from this pose, in part
            keyframe.appearance = None

    def polish(self) -> None:
        """After the last frame: all keyframes, in steps that shrink to nothing, within the budget of time."""
        c, start = self.config.refinement, perf_counter()
        refined = max(1, c.keyframes // 2)
        updates = max(c.updates, math.ceil(c.rounds * len(self.graph.keyframes) / refined))
        for i in range(updates):
            spent = (perf_counter() - start) / c.seconds
            done = i / updates if spent < (i + 1) / updates else spent  # the clock counts only where time runs short: repeatable elsewhere
            if done >= 1:
                break
            keyframes = self.graph.sample(c.keyframes)
            self.refine(keyframes[:refined])
            self.mapper.start(keyframes, self.config.mapper.iterations, anneal=1 - done)
        self.mapper.finish()
        self.mapper.optimiser.anneal = 1.0
