"""iDF-SLAM (Fig. 2): the neural tracker in front, the neural implicit mapper behind, keyframes between them."""

import logging
from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from time import perf_counter

import numpy as np
import torch
import trimesh
from numpy.typing import NDArray
from torch import Tensor

from idfslam.config import FAST, Config
from idfslam.frame import Frame, FrameResult, Status
from idfslam.graph.keyframes import Keyframe, KeyframeGraph
from idfslam.hardware import resolve_device
from idfslam.mapping.mapper import Mapper
from idfslam.mapping.saved_map import mesh_of, save_map
from idfslam.tracking.alignment import Aligner, Alignment
from idfslam.tracking.motion import Information, MotionModel, change_between, moved
from idfslam.tracking.tracker import Described, Tracker

log = logging.getLogger(__name__)

_BETTER = 1.05  # another guess's score must be so many times the first one's: where all fit alike, the predicted motion stands


class Slam:
    """Frames in, poses and a map out; one process, sequential, seeded.

    The world is the first frame's camera. Two runs with one config on one machine give the same result.
    """

    def __init__(self, config: Config = FAST) -> None:
        self.config = config
        self.device = resolve_device(config.device)
        torch.manual_seed(config.seed)
        host = torch.Generator().manual_seed(config.seed)
        self.tracker = Tracker(config.tracker, config.finetune, self.device, config.seed)
        self.mapper = Mapper(config.mapper, config.field, self.device, torch.Generator(self.device).manual_seed(config.seed))
        self.aligner = Aligner(config.alignment, self.mapper.field, host)
        self.graph = KeyframeGraph(config.keyframes, host)
        self.timings: dict[str, list[float]] = defaultdict(list)  # [ms] a call, by stage
        self._finished = False
        self._unmapped: Keyframe | None = None  # the last frame, if it is no keyframe
        self.motion = MotionModel()
        self._in_view = 1.0  # share of the references' landmarks that the last frame saw

    def process(self, frame: Frame) -> FrameResult:
        """Track a frame; then refine the map by it, if it is to be a keyframe, or else the tracker."""
        current = self._view(frame)
        status = self._track(current)
        self.graph.append(frame.timestamp, current.T_wk, status)
        chosen = self._chosen(current, status)
        self._unmapped = None if chosen or status is Status.LOST else current
        if chosen:
            losses = self._map(current)
        elif self.config.mapper.every and frame.index % self.config.mapper.every == 0 and status is not Status.LOST:
            losses = self._refresh(current)
        else:
            losses = self._finetune()
        return FrameResult(frame.index, frame.timestamp, self.graph.T_wc(-1).numpy(), status, chosen, losses)

    def finish(self) -> None:
        """The end of a run: the last frame is kept too, and the keyframes' poses and the map get a last polish over all of them."""
        if self._finished or not self.graph.keyframes:
            return
        self._finished = True
        if self._unmapped is not None and self.config.mapper.final_updates:
            self._map(self._unmapped)  # or what came into view in the last frames would be in no keyframe
        with self._timed("finish"):
            updates = self.config.mapper.final_updates
            for i in range(updates):
                self.mapper.optimiser.anneal = 1 - i / updates
                keyframes = self.graph.sample(self.config.mapper.final_keyframes)
                self._refine(keyframes[: self.config.mapper.final_keyframes // 2])
                self.mapper.optimise_map(keyframes, self.config.mapper.iterations)
            self.mapper.optimiser.anneal = 1.0

    def mesh(self, resolution: float | None = None) -> trimesh.Trimesh:
        """The observed surface in cells of `resolution` [m] (none: the config's), with vertex colours."""
        return mesh_of(self.mapper.field, self.graph.views(), resolution or self.config.mesh.resolution)

    def save_map(self, path: Path) -> None:
        """The map as one file, to be read by `idfslam.mapping.saved_map.load_map`."""
        save_map(path, self.mapper.field, self.graph.views())

    def trajectory(self) -> NDArray[np.float64]:
        """(N, 4, 4) camera-to-world poses of all frames processed; frames follow their keyframes."""
        return self.graph.trajectory()

    def statuses(self) -> list[Status]:
        """How the pose of each processed frame was found."""
        return self.graph.statuses()

    def _view(self, frame: Frame) -> Keyframe:
        """The frame on the map's device, at the pose that the last motion predicts."""
        T_wc = self.motion.predict(self.graph.T_wc(-1)) if len(self.graph) else torch.eye(4, dtype=torch.float64)
        return Keyframe(frame, T_wc, torch.from_numpy(frame.depth).to(self.device), torch.from_numpy(frame.colour).to(self.device))

    def _track(self, current: Keyframe) -> Status:
        """Sec. V, or the map's alignment where that is on, sets the pose; lost, it stays as predicted.

        The first frame with depth is the world; those before it are lost.
        """
        if not self.graph.keyframes:
            return Status.OK if bool((current.depth > 0).any()) else Status.LOST
        last, information = self.graph.T_wc(-1), None
        if self.config.alignment.enabled:
            current.T_wk, status, information = self._align(current)
        else:
            current.T_wk, status = self._register(current)
        if status is Status.LOST:
            self.motion.stop()
        else:
            self.motion.update(last, current.T_wk, information, self.config.alignment.hold)
        return status

    def _register(self, current: Keyframe) -> tuple[Tensor, Status]:
        """The neural tracker's pose against the reference keyframe (Sec. V)."""
        reference = self.graph.reference
        assert reference is not None
        with self._timed("track"):
            result = self.tracker.track(self._described(current), self._described(reference))
        if result.status is Status.LOST:
            return current.T_wk, Status.LOST
        return reference.T_wk @ torch.from_numpy(result.T_kc), result.status

    def _align(self, current: Keyframe) -> tuple[Tensor, Status, Information | None]:
        """Align to the map from the predicted pose; in doubt also from the tracker's and from the last pose: one that is better stands."""
        references = self.graph.references(self.config.alignment.references)
        best: Alignment | None = None
        tracked: Tensor | None = None
        for guess in ("motion", "tracker", "last"):
            T_guess = current.T_wk if guess == "motion" else self.graph.T_wc(-1)
            if guess == "tracker":
                T_guess, status = self._register(current)
                if status is Status.LOST:
                    continue
                tracked = T_guess
            with self._timed("align"):
                aligned = self.aligner.align(current, T_guess, references)
            if best is None or aligned.score > _BETTER * best.score:
                best = aligned
            if not self.aligner.doubtful(best):
                break
        assert best is not None
        if best.status is not Status.LOST:
            self.aligner.accept(best)
            self._in_view = best.in_view
            return best.T_wc, best.status, best.information
        return (current.T_wk, Status.LOST, None) if tracked is None else (tracked, Status.OK, None)

    def _chosen(self, current: Keyframe, status: Status) -> bool:
        """Whether the frame is to be a keyframe: moved enough, or lost (Sec. III); never one without depth."""
        return bool((current.depth > 0).any()) and self.graph.asks_for_keyframe(current.T_wk, status, self._in_view)

    def _map(self, keyframe: Keyframe) -> dict[str, float]:
        """The pose against the map, then the map by the new keyframe and the replayed (Sec. IV)."""
        first = not self.graph.keyframes
        losses: dict[str, float] = {}
        if self.config.mapper.pose_optimisation and not first:
            with self._timed("pose"):
                losses |= self.mapper.optimise_pose(keyframe)
        if self.graph.promote(keyframe):
            self.mapper.optimiser.grow()
        self.graph.cover(keyframe)
        self._described(keyframe)
        if first:
            with self._timed("map"):
                return self.mapper.initialise(keyframe)
        return losses | self._optimise(keyframe)

    def _refresh(self, current: Keyframe) -> dict[str, float]:
        """A map update on a frame that is not kept."""
        assert self.graph.reference is not None
        current.neighbours = self.graph.reference.neighbours
        self.graph.cover(current)
        return self._optimise(current)

    def _optimise(self, current: Keyframe) -> dict[str, float]:
        """Bundle adjustment over the replay window, in turns: the replayed keyframes' poses against the map, the map against all."""
        replayed = self.graph.replay(current)
        with self._timed("refine"):
            self._refine(replayed[: self.config.alignment.refined])
        with self._timed("map"):
            return self.mapper.optimise_map([current, *replayed], self.config.mapper.iterations)

    def _refine(self, keyframes: Sequence[Keyframe]) -> None:
        """Keyframes' poses against the map as it has become since, and earlier keyframes' images. The first stays: it is the world."""
        for keyframe in keyframes if self.config.alignment.enabled else []:
            if keyframe is self.graph.keyframes[0]:
                continue
            aligned = self.aligner.align(keyframe, keyframe.T_wk, self.graph.earlier(keyframe, self.config.alignment.references), near=True)
            change = change_between(keyframe.T_wk, aligned.T_wc)
            near = float(change[:3].norm()) < self.config.alignment.refine_reach
            if aligned.status is Status.OK and near and not self.aligner.doubtful(aligned):
                keyframe.T_wk = moved(keyframe.T_wk, change / 2)  # half way: what the map knows here it has from this pose, in part
            keyframe.appearance = None

    def _finetune(self) -> dict[str, float]:
        """One step of the tracker on a pair of consecutive keyframes (Eq. 6), the map frozen."""
        config = self.config.finetune
        if not config.enabled or len(self.graph.keyframes) < config.keyframes or len(self.graph) % config.every:
            return {}
        with self._timed("finetune"):
            described = [self._described(k) for k in self.graph.keyframes]
            T_wk = np.stack([k.T_wk.numpy() for k in self.graph.keyframes])
            losses = self.tracker.finetune(described, T_wk, self.mapper.renderer(self.graph.keyframes))
        return {f"finetune_{name}": value for name, value in (losses or {}).items()}

    def _described(self, keyframe: Keyframe) -> Described:
        if keyframe.described is None:
            keyframe.described = self.tracker.describe(keyframe.frame)
        return keyframe.described

    @contextmanager
    def _timed(self, stage: str) -> Iterator[None]:
        start = perf_counter()
        yield
        self.timings[stage].append((perf_counter() - start) * 1e3)
