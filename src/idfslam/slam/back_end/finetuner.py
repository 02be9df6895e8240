"""Online finetuning of the tracker (Sec. V-B): one step on a pair of keyframes after every so many registrations."""

from abc import ABC, abstractmethod
from typing import Any

import numpy as np

from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.mapping.mapper import Mapper
from idfslam.slam.keyframe_features import KeyframeFeatures
from idfslam.slam.stage_timer import StageTimer
from idfslam.tracking.tracker import Tracker


class Finetuning(ABC):
    """Finetunes the tracker."""

    @abstractmethod
    def step(self) -> dict[str, float]:
        """One step, if it is due; returns its losses by name."""

    def figures(self) -> dict[str, Any]:
        """Counts for metrics.json."""
        return {"finetuning_rollbacks": 0}


class NoFinetuning(Finetuning):
    """The tracker stays as it was trained."""

    def step(self) -> dict[str, float]:
        return {}


class Finetuner(Finetuning):
    """Finetunes the tracker's out-conv. The map is frozen."""

    def __init__(self, tracker: Tracker, features: KeyframeFeatures, mapper: Mapper, graph: KeyframeGraph, timer: StageTimer) -> None:
        self.tracker, self.features, self.mapper, self.graph, self.timer = tracker, features, mapper, graph, timer

    def step(self) -> dict[str, float]:
        """One step on a random pair of consecutive keyframes (Eq. 6), if it is due; returns its losses by name."""
        keyframes = self.graph.keyframes
        if not (self.tracker.due and self.tracker.learns(len(keyframes))):
            return {}
        with self.timer.stage("finetune"):
            T_wk = np.stack([k.T_wk.numpy() for k in keyframes])
            losses = self.tracker.finetune(self.features.of_all(keyframes), T_wk, self.mapper.renderer(keyframes))
        return {f"finetune_{name}": value for name, value in (losses or {}).items()}

    def figures(self) -> dict[str, Any]:
        return {"finetuning_rollbacks": self.tracker.validator.rollbacks}
