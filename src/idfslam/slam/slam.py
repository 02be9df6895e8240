"""iDF-SLAM (Fig. 2): the neural tracker in front, the neural implicit mapper behind, keyframes between them."""

import logging
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import torch
import trimesh
from numpy.typing import NDArray
from torch import Tensor

from idfslam.alignment.aligner import Aligner, Alignment
from idfslam.alignment.motion import Information, MotionModel
from idfslam.compute.devices import resolve_device, threads
from idfslam.config import FAST, Config
from idfslam.errors import RecordingError
from idfslam.frame import Frame, FrameResult, Status
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.mapping.fused import distance_query
from idfslam.mapping.mapper import Mapper
from idfslam.mapping.saved_map import SavedMap, mesh_of, save_map
from idfslam.slam.loop_closer import LoopCloser
from idfslam.slam.refinement import BundleAdjustment
from idfslam.slam.relocalisation_check import Trial
from idfslam.slam.relocaliser import Descriptions, Localiser
from idfslam.slam.submap_merger import PieceJoiner
from idfslam.storage.state import State, Stateful
from idfslam.tracking.tracker import Described, Tracker

log = logging.getLogger(__name__)

_HURRIED = 2  # map updates: a keyframe that comes no later after the last one is of a camera that runs ahead of the map
_AT_ONCE = 10  # map updates around a piece that has moved, before the next frame; the rest follows as after a loop
_EXAMPLES = 16  # keyframes of a saved map that tell how well its images fit each other
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
        self.aligner = Aligner(config.alignment, distance_query(self.mapper.published), config.field.truncation, host)
        self.localiser = Localiser(self.tracker, self.aligner)
        self.graph = KeyframeGraph(config.keyframes, host, verify=config.loops.enabled and config.front_end == "alignment")
        self.loop_closer = LoopCloser(config.loops, self.localiser, self.graph)
        self.piece_joiner = PieceJoiner(config.loops, self.localiser, self.graph)
        self.trial = Trial(self.aligner, self.graph)
        self.adjustment = BundleAdjustment(config, self.graph, self.mapper, self.aligner, self.localiser)
        self.relocalisations = 0
        self._looked_for = 0  # frames with depth since the camera was lost
        self.timings: dict[str, list[float]] = defaultdict(list)  # [ms] a call, by stage
        self._finished = False
        self._unmapped: Keyframe | None = None  # the last frame, if it is no keyframe
        self._updated_at = 0  # frames processed when the map last got an update
        self.motion = MotionModel()
        self._live: list[NDArray[np.float64]] = []  # each frame's pose as it was first told
        self._in_view = 1.0  # share of the references' landmarks that the last frame saw
        self._known = 1.0  # share of its depth that the map knew
        self._least_information = 0.0  # of its pose in any direction, by map and images, per unit weight

    def start_in(self, saved: SavedMap, keyframes: Sequence[tuple[Frame, Tensor]]) -> None:
        """Before the first frame: a saved map, whose field is of this config, and its keyframes with poses T_wk (4, 4).

        The camera counts as lost until it is found there; from then on the map is extended.
        """
        self.mapper.take_over(saved.field)
        for frame, T_wk in keyframes:
            view = self._view(frame)
            view.T_wk = T_wk
            self.graph.adopt(view)
        self.graph.cover_with(saved.views)
        self._expect_what_keyframes_show()

    def _expect_what_keyframes_show(self) -> None:
        """How well the colours of keyframes fit each other at their poses is how well those of a frame can, that is found among them."""
        differences = []
        for keyframe in self.graph.sample(_EXAMPLES):
            references = self.graph.earlier(keyframe, self.config.alignment.references)
            differences += [self.aligner.compare(keyframe, other, keyframe.T_wk)[1] for other in references]
            keyframe.appearance = None
        self.aligner.expect(differences)

    def process(self, frame: Frame) -> FrameResult:
        """Track a frame; then refine the map by it, if it is to be a keyframe, or else the tracker."""
        with threads(0.5 if self.config.mapper.background else 1.0):
            return self._process(frame)

    def _process(self, frame: Frame) -> FrameResult:
        current = self._view(frame)
        status = self._track(current)
        found_again = self._lost and status is not Status.LOST
        self.graph.append(frame.timestamp, current.T_wk, status)
        if found_again and self._relocalises and not self.graph.begins_piece:
            log.info("found again at frame %d; %d frames before it are interpolated", frame.index, self.graph.bridge())
        chosen = self._chosen(current, status)
        self._unmapped = None if chosen or status is Status.LOST else current
        if chosen:
            losses = self._map(current)
        elif self._due and status is not Status.LOST:
            losses = self._refresh(current)
        else:
            losses = self._finetune()
        if self.graph.piece(-1) == 0:
            self._live.append(self.graph.T_wc(-1).numpy())
        else:  # where that is in the world is not known
            self._live.append(self._live[-1] if self._live else np.eye(4))
            status = Status.LOST
        return FrameResult(frame.index, frame.timestamp, self._live[-1], status, chosen, losses)

    def finish(self) -> None:
        """The end of a run: the last frame is kept too, and all keyframes' poses and the map get a last polish."""
        if self._finished or not self.graph.keyframes:
            return
        self._finished = True
        if alone := sum(self.graph.piece(i) != 0 for i in range(len(self.graph))):
            log.warning("%d frames are of pieces that never met the first: they count as lost, and the map shows nothing of them", alone)
        if not self.config.refine:
            return
        if self._unmapped is not None:
            self._map(self._unmapped)  # or what came into view in the last frames would be in no keyframe
        with self._timed("finish"):
            self.adjustment.polish()

    def mesh(self, resolution: float | None = None) -> trimesh.Trimesh:
        """The observed surface in cells of `resolution` [m] (none: the config's), with vertex colours."""
        return mesh_of(self.mapper.learnt(), self.graph.views(), resolution or self.config.mesh.resolution)

    def save_map(self, path: Path) -> None:
        """The map as one file, to be read by `idfslam.mapping.saved_map.load_map`."""
        save_map(path, self.mapper.learnt(), self.graph.views())

    def trajectory(self) -> NDArray[np.float64]:
        """(N, 4, 4) camera-to-world poses of all frames processed; frames follow their keyframes."""
        return self.graph.trajectory()

    def live_trajectory(self) -> NDArray[np.float64]:
        """(N, 4, 4) the poses as they were told while the camera moved: before later frames, loops and the last polish improved them."""
        return np.stack(self._live) if self._live else np.zeros((0, 4, 4))

    def figures(self) -> dict[str, Any]:
        """What metrics.json tells: links and loops (pairs of frames) of the keyframes, lost cameras found again, finetuning undone."""
        pieces = {
            "pieces": len({k.piece for k in self.graph.keyframes}),
            "pieces_joined": self.piece_joiner.joined,
            "places_refuted": self.trial.refuted,
        }
        found = {"relocalisations": self.relocalisations, **pieces, "finetuning_undone": self.tracker.guard.undone}
        return self.loop_closer.loops.summary(self.graph) | found

    def statuses(self) -> list[Status]:
        """How the pose of each processed frame was found."""
        return self.graph.statuses()

    def state(self) -> State:
        """The whole run up to here, without images (`idfslam.storage.state`); a component that changes is named in `_parts`."""
        return {
            **{name: part.state() for name, part in self._parts().items()},
            "graph": self.graph.state(),
            "unmapped": None if self._unmapped is None else self._unmapped.state(),
            "in_view": self._in_view,
            "known": self._known,
            "least_information": self._least_information,
            "updated_at": self._updated_at,
            "relocalisations": self.relocalisations,
            "looked_for": self._looked_for,
            "live": torch.from_numpy(self.live_trajectory()),
            "finished": self._finished,
            "timings": {stage: torch.tensor(ms, dtype=torch.float64) for stage, ms in self.timings.items()},
        }

    def restore(self, state: State, frame: Callable[[int], Frame]) -> None:
        """What `state` told, in a new Slam of the same config: it goes on as the first would have, to the last bit on one machine.

        frame: the frame of an index, as it was processed. Raises RecordingError where its images are others.
        """

        def revive(kept: State) -> Keyframe:
            again = self._keyframe(frame(kept["index"]), kept["T_wk"])
            if again.frame.checksum() != kept["images"]:
                raise RecordingError(f"frame {again.index} has other images than in the run that is to go on; expected the same recording")
            again.restore(kept)
            return again

        self.graph.restore(state["graph"], revive)
        for name, part in self._parts().items():
            part.restore(state[name])
        self._unmapped = None if state["unmapped"] is None else revive(state["unmapped"])
        self._in_view, self._known, self._least_information = state["in_view"], state["known"], state["least_information"]
        self.relocalisations, self._updated_at, self._finished = state["relocalisations"], state["updated_at"], state["finished"]
        self._looked_for = state["looked_for"]
        self._live = list(state["live"].numpy())
        self.timings = defaultdict(list, {stage: ms.tolist() for stage, ms in state["timings"].items()})

    def _parts(self) -> dict[str, Stateful]:
        """What changes while a run goes on, beside the graph."""
        localisation: dict[str, Stateful] = {
            "localiser": self.localiser,
            "loop_closer": self.loop_closer,
            "piece_joiner": self.piece_joiner,
            "trial": self.trial,
        }
        return {"tracker": self.tracker, "mapper": self.mapper, "aligner": self.aligner, "motion": self.motion, **localisation}

    def _view(self, frame: Frame) -> Keyframe:
        """The frame on the map's device, at the pose that the last motion predicts."""
        return self._keyframe(frame, self.motion.predict(self.graph.T_wc(-1)) if len(self.graph) else torch.eye(4, dtype=torch.float64))

    def _keyframe(self, frame: Frame, T_wc: Tensor) -> Keyframe:
        return Keyframe(frame, T_wc, torch.from_numpy(frame.depth).to(self.device), torch.from_numpy(frame.colour).to(self.device))

    def _track(self, current: Keyframe) -> Status:
        """Sec. V, or the map's alignment where that is on, sets the pose; lost, it stays as predicted.

        The first frame with depth is the world; those before it are lost.
        """
        if not self.graph.keyframes:
            return Status.OK if current.has_depth else Status.LOST
        last, information = self._last_pose(current), None
        was_lost, found_before = self._lost, self.relocalisations
        if self.config.front_end == "alignment":
            current.T_wk, status, information = self._align(current)
        else:
            current.T_wk, status = self._register(current)
        if self._gives_up(current, status):
            current.T_wk, status = self.graph.begin_piece(), Status.OK
            log.info("not found for %d frames: from frame %d on a piece of its own is mapped", self._looked_for, current.index)
        if status is Status.LOST or was_lost or self.relocalisations > found_before:
            self.motion.stop()  # from where it was last known to where it was found is not the motion of one frame
        else:
            self.motion.update(last, current.T_wk, information, self.config.alignment.prior_information)
        return status

    def _register(self, current: Keyframe) -> tuple[Tensor, Status]:
        """The neural tracker's pose against the reference keyframe (Sec. V)."""
        with self._timed("track"):
            for reference in self.graph.tracking_references(current):
                result = self.tracker.track(self._described(current), self._described(reference))
                if result.status is not Status.LOST:
                    return reference.T_wk @ torch.from_numpy(result.T_kc), result.status
        return current.T_wk, Status.LOST

    def _align(self, current: Keyframe) -> tuple[Tensor, Status, Information | None]:
        """Align to the map, from wherever that goes best; a lost camera is looked for among all keyframes."""
        best, tracked = self._aligned(current)
        accidental = best.status is Status.LOST or (self._lost and not self.localiser.convincing(best))
        if accidental and self._relocalises:
            best, tracked = self._relocalised(current) or replace(best, status=Status.LOST), None if self._lost else tracked
        if best.status is not Status.LOST:
            self.aligner.accept(best, current.T_wk)
            self._in_view, self._known, self._least_information = best.in_view, best.overlap, best.least_information
            return best.T_wc, best.status, best.information
        self._least_information = 0.0
        return (current.T_wk, Status.LOST, None) if tracked is None else (tracked, Status.OK, None)

    def _aligned(self, current: Keyframe) -> tuple[Alignment, Tensor | None]:
        """From the predicted pose; in doubt also from the tracker's and the last pose: one that is better stands. And the tracker's."""
        references = self.graph.references(self.config.alignment.references)
        predicted, expected = current.T_wk, self.aligner.expected
        narrow = [] if expected is None else [("motion", expected)]
        best: Alignment | None = None
        tracked: Tensor | None = None
        for guess, within in (*narrow, ("motion", None), ("tracker", None), ("last", None)):
            T_guess = predicted if guess == "motion" else self._last_pose(current)
            if guess == "tracker":
                T_guess, status = self._register(current)
                if status is Status.LOST:
                    continue
                tracked = T_guess
            with self._timed("align"):
                aligned = self.aligner.align(current, T_guess, references, within=within)
            if best is None or aligned.score > _BETTER * best.score:
                best = aligned
            if not self.aligner.doubtful(best) and not self.aligner.unexpected(aligned, T_guess, within):
                break
        assert best is not None
        return best, tracked

    def _relocalised(self, current: Keyframe) -> Alignment | None:
        """The view's pose by the keyframes that look most like it, which it is then held against; None if none is convincing."""
        if not current.has_depth:
            return None
        with self._timed("relocalise"):
            tries = self.config.loops.relocalisation_tries
            answer = self.localiser.locate_among(current, self.graph.keyframes, tries, self.graph)
        if answer is None:
            return None
        self.graph.settle(current, answer[0])
        self.trial.begin()
        self.relocalisations += 1
        return answer[1]

    def _gives_up(self, current: Keyframe, status: Status) -> bool:
        """Whether a lost camera has been looked for long enough, by frames in which something could be seen."""
        if status is not Status.LOST:
            self._looked_for = 0
        elif self._relocalises and current.has_depth:
            self._looked_for += 1
        return 0 < self.config.loops.submap_after <= self._looked_for

    def _chosen(self, current: Keyframe, status: Status) -> bool:
        """Whether the frame is to be a keyframe: moved enough, or lost (Sec. III) unless it is looked for; never one without depth."""
        if status is Status.LOST and self._relocalises:
            return False
        return current.has_depth and self.graph.asks_for_keyframe(current.T_wk, status, self._in_view)

    def _map(self, keyframe: Keyframe) -> dict[str, float]:
        """The pose against the map, then the map by the new keyframe and the replayed (Sec. IV)."""
        last = self.graph.reference
        first = last is None
        hurried = last is not None and keyframe.index - last.index <= _HURRIED * self.config.mapper.every
        losses: dict[str, float] = {}
        if self.config.mapper.pose_optimisation and not first:
            with self._timed("pose"):
                losses |= self.mapper.optimise_pose(keyframe)
        if self.config.front_end == "alignment":
            with self._timed("register"), threads(1.0):
                self.adjustment.register(keyframe, self._least_information)
        stored = self.graph.promote(keyframe)
        self._described(keyframe)
        if self.trial.refutes(keyframe):
            self._cut(keyframe)
        elif self.graph.verify:
            with self._timed("loops"):
                self.loop_closer.close(keyframe)
                joined = self.piece_joiner.join(keyframe)
            if joined:
                self._learn_moved(keyframe)
                log.info("%d frames between the pieces are interpolated", self.graph.bridge())
        self.graph.cover(keyframe)
        if first:
            with self._timed("map"), threads(1.0):
                replayed = self.graph.replay(keyframe) if keyframe.anchor else []  # another piece begins: the map is to keep the others
                return self.mapper.initialise([keyframe, *replayed])
        return losses | self._optimise(keyframe, at_once=hurried or self._known < self.config.mapper.min_mapped_share, grow=stored)

    def _cut(self, keyframe: Keyframe) -> None:
        """Where the camera was found, it was not: what was mapped since goes on as a piece of its own, and the map forgets it there."""
        log.info("frame %d contradicts where the camera was found: mapping goes on in a piece of its own", keyframe.index)
        for other in self.graph.cut():
            other.unlearnt = self.config.loops.relearn_updates
        for other in self.graph.keyframes:
            if other.piece == keyframe.piece:
                other.unlearnt = self.config.loops.relearn_updates
        self.loop_closer.loops.forget_between(self.graph)
        self.piece_joiner.agreeing = []  # found where the camera was thought to be
        self._learn_moved(keyframe)

    def _learn_moved(self, keyframe: Keyframe) -> None:
        """After a piece has moved: the map around a keyframe of it, so that the next frames are found there; the rest follows later."""
        with self._timed("map"), threads(1.0):
            for _ in range(_AT_ONCE):
                self.mapper.optimise_map([keyframe, *self.graph.replay(keyframe)], self.config.mapper.iterations)

    def _refresh(self, current: Keyframe) -> dict[str, float]:
        """A map update on a frame that is not kept."""
        assert self.graph.reference is not None
        current.neighbours = set(self.graph.reference.neighbours)
        self.graph.cover(current)
        return self._optimise(current, at_once=False)

    def _optimise(self, current: Keyframe, *, at_once: bool, grow: bool = False) -> dict[str, float]:
        """Bundle adjustment over the replay window, in turns: the replayed keyframes' poses against the map, the map against all.

        at_once: the next frame is aligned to it already. Otherwise the map learns beside the frames that follow, and the losses are those
        of the update before.
        """
        self._updated_at = len(self.graph)
        replayed = self.graph.replay(current)
        with self._timed("refine"):
            self.adjustment.refine(replayed[: self.config.refinement.poses_per_update])
        window, iterations = [current, *replayed], self.config.mapper.iterations
        if at_once or not self.config.mapper.background:
            with self._timed("map"), threads(1.0):
                losses = self.mapper.optimise_map(window, iterations, grow=grow)
        else:
            with self._timed("wait"):
                losses = self.mapper.start(window, iterations, grow=grow)
        self.timings["map"] += self.mapper.beside.times()
        return losses

    def _finetune(self) -> dict[str, float]:
        """One step of the tracker on a pair of consecutive keyframes (Eq. 6), the map frozen."""
        if not (self.tracker.due and self.tracker.learns(len(self.graph.keyframes))):
            return {}
        with self._timed("finetune"):
            described = Descriptions(self.localiser, self.graph.keyframes)
            T_wk = np.stack([k.T_wk.numpy() for k in self.graph.keyframes])
            losses = self.tracker.finetune(described, T_wk, self.mapper.renderer(self.graph.keyframes))
        return {f"finetune_{name}": value for name, value in (losses or {}).items()}

    def _last_pose(self, current: Keyframe) -> Tensor:
        return self.graph.T_wc(-1) if len(self.graph) else current.T_wk

    def _described(self, keyframe: Keyframe) -> Described:
        return self.localiser.described(keyframe)

    @property
    def _due(self) -> bool:
        """Whether the map's last update is `every` frames old."""
        return 0 < self.config.mapper.every <= len(self.graph) - self._updated_at

    @property
    def _lost(self) -> bool:
        """Whether the last frame was; at the start, whether there is a map to be found in."""
        return self.graph.status() is Status.LOST if len(self.graph) else bool(self.graph.keyframes)

    @property
    def _relocalises(self) -> bool:
        """Whether a lost camera is looked for; otherwise frames are mapped where the last motion leads (Sec. III)."""
        return self.config.loops.relocalise and self.config.front_end == "alignment"

    @contextmanager
    def _timed(self, stage: str) -> Iterator[None]:
        start = perf_counter()
        yield
        self.timings[stage].append((perf_counter() - start) * 1e3)
