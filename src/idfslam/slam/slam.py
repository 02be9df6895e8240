"""iDF-SLAM (Fig. 2): a neural tracker as the front end, a neural implicit map as the back end, and keyframes between them."""

import logging
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
import trimesh
from numpy.typing import NDArray
from torch import Tensor

from idfslam.config import FAST, Config
from idfslam.errors import ConfigError, RecordingError, ResultError
from idfslam.frame import Frame, FrameResult, Status, StoredKeyframe
from idfslam.fusion.tsdf_volume import TsdfVolume
from idfslam.graph.coverage import EARLIER
from idfslam.graph.held_out import is_held_out
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.loop_consistency import Loop
from idfslam.mapping.implicit_surface import ImplicitSurface
from idfslam.mapping.saved_map import SavedMap, mesh_of, save_map
from idfslam.slam.compose import BackEnd, FrontEnd, Map, System
from idfslam.slam.frame_order import FrameOrder
from idfslam.slam.history import History
from idfslam.slam.place_recognition.recovery import EXAMPLES, Mode
from idfslam.slam.repeated_images import RepeatedImages
from idfslam.slam.tracked import Tracked
from idfslam.slam.world_origin import WorldOrigin
from idfslam.storage.state import State, parts_of
from idfslam.views.image_archive import ImageArchive, archive_of
from idfslam.views.surface_colour import recoloured

log = logging.getLogger(__name__)

_FIGURES = {  # defaults for a system without these parts
    "loops": [],
    "loops_refused": 0,
    "submaps_merged": 0,
    "relocalisations_refuted": 0,
    "sensor_timing": None,
    "sensor_timing_estimates": None,
}


class Slam:
    """Computes poses and a map from frames.

    The world is the frame of the first camera. On the CPU, two runs with one config on one machine give the same result.
    """

    def __init__(
        self,
        config: Config = FAST,
        *,
        front_end: Callable[[System], FrontEnd] | None = None,
        back_end: Callable[[System], BackEnd] | None = None,
        map: Callable[[System], Map] | None = None,
    ) -> None:
        """front_end, back_end, map: make these parts instead of those that the config names (`compose.py`)."""
        system = System(config, front_end=front_end, back_end=back_end, map=map)
        self.config, self.device, self.timer = config, system.device, system.timer
        self.graph, self.frames, self.coverage, self.motion = system.graph, system.frames, system.coverage, system.motion
        self.front_end, self.recovery, self.back_end = system.front_end, system.recovery, system.back_end
        self.segmentation, self.hindsight = system.segmentation, system.hindsight
        self.keyframe_selection, self.mapper, self.replay = system.keyframe_selection, system.map, system.replay
        self.views, self.adjustment, self.surface_fusion = system.views, system.adjustment, system.surface_fusion
        self.resection = system.resection
        self.history = History(system.frames)
        self._pending: tuple[Keyframe, Tracked] | None = None  # the last frame, if its pose is trusted and it is no keyframe
        self._finished = False
        self._archive: ImageArchive | None = None  # once the poses are final
        self._volume: TsdfVolume | None = None  # likewise
        self.order, self.repeated, self.origin = FrameOrder(), RepeatedImages(), WorldOrigin()

    def process(self, frame: Frame) -> FrameResult:
        """Tracks a frame. Then maps it if it becomes a keyframe, and otherwise updates the map or finetunes the tracker.

        Raises FrameError if the frame's index is not the number of frames before it, or if its camera is another than theirs.
        """
        self.order.check(frame)
        view, mode = self._view(self.repeated.check(frame), self._predicted_pose()), self.recovery.mode
        view.colour_since = self.repeated.colour_since
        self.segmentation.predict(view)
        tracked = self._track(view, mode)  # Sec. V
        view.T_wk = tracked.T_wc
        self.frames.append(frame.timestamp, tracked.T_wc, tracked.status)
        self.recovery.close_gap(frame.index, mode)
        selected = self._selects(view, tracked)  # Sec. III
        mappable = tracked.may_be_mapped and view.has_depth
        self._pending = (view, replace(tracked, alignment=None)) if mappable and not selected else None  # as a state has it
        losses = self.back_end.add_keyframe(view, tracked) if selected else self.back_end.between_keyframes(view, tracked)  # Sec. IV
        if mappable:
            with self.timer.stage("archive"):
                self.views.add(view, self.keyframe_selection.sharpness.latest)
        with self.timer.stage("resection"):
            self.resection.see(view, tracked)
        self.segmentation.remember(view, tracked)
        return self.history.report(frame, tracked, losses, keyframe=selected, moving=view.moving)

    def _track(self, view: Keyframe, mode: Mode) -> Tracked:
        """Tracks a view from its predicted pose. One that is held out is not clear: neither map nor keyframes get it."""
        tracked = self._track_in_map(view, mode) if self.graph.keyframes else self.segmentation.segment(view, self.origin.track(view))
        return replace(tracked, clear=False) if is_held_out(view.index, self.config.hold_out) else tracked

    def _track_in_map(self, view: Keyframe, mode: Mode) -> Tracked:
        tracked = self.segmentation.check(view, self.front_end.track(view), self.front_end)
        T_last = self.frames.last_pose(view.T_wk)
        tracked = self.segmentation.segment(view, self.recovery.recover(view, tracked))
        self.front_end.accept(view, tracked)
        if mode is Mode.TRACKING and tracked.continues_motion:
            information = None if tracked.alignment is None else tracked.alignment.information
            self.motion.update(T_last, tracked.T_wc, information, self.config.alignment.prior_information)
        else:  # the change since the last tracked pose is not the motion of one frame
            self.motion.stop()
        return tracked

    def _selects(self, view: Keyframe, tracked: Tracked) -> bool:
        evidence = tracked.evidence
        return self.keyframe_selection.selects(view, tracked.status, evidence.in_view, evidence.step, clear=tracked.clear)

    def _predicted_pose(self) -> Tensor:
        return self.motion.predict(self.frames.T_wc(-1)) if len(self.frames) else torch.eye(4, dtype=torch.float64)

    def _view(self, frame: Frame, T_wc: Tensor) -> Keyframe:
        """A frame on the map's device, at pose `T_wc` (4, 4)."""
        return Keyframe(frame, T_wc, torch.from_numpy(frame.depth).to(self.device), torch.from_numpy(frame.colour).to(self.device))

    def swap_to(self, folder: Path) -> None:
        """Makes the swap file in a folder instead of that of temporary files. To be called before the first frame."""
        self.graph.swap.folder = folder

    def start_in(self, saved: SavedMap, keyframes: Sequence[tuple[Frame, Tensor]], archive: ImageArchive | None = None) -> None:
        """Starts in a saved map with a field of this config, its keyframes with poses T_wk (4, 4), and its images, before the first frame.

        The camera counts as lost until it is relocalised in the map. From then on the map is extended.
        """
        self.mapper.take_over(saved.field)
        for frame, T_wk in keyframes:
            self.graph.load(self._view(frame, T_wk))
        self.coverage.load(saved.views)
        if archive is not None:
            self.views.load(archive)
        self.recovery.start_in_map(self.replay.sample(EXAMPLES))

    def finish(self) -> None:
        """Ends a run: maps the last frame too, polishes the keyframes' poses and the map, and fuses the depth of mapped views.

        Without any mapped frame there is no work.
        """
        if self._finished or not self.graph.keyframes:
            return
        self._finished = True
        if self.config.refine and self._pending is not None:
            self.back_end.add_keyframe(*self._pending)  # otherwise no keyframe would have what came into view in the last frames
            self.resection.see(*self._pending)
        self.graph.choose_main_submap()
        main = self.graph.main_submap
        if alone := sum(self.frames.submap(i) != main for i in range(len(self.frames))):
            log.warning(
                "%d frames are of submaps that were not merged with the largest: they count as lost, and the map leaves them out", alone
            )
        self.views.finish()
        self.hindsight.run()
        self.back_end.finish()
        self.frames.spread_corrections()
        self.front_end.smooth()
        self.resection.run()
        self.coverage.place(self.frames.in_host)
        with self.timer.stage("fuse"):
            self._volume = self.surface_fusion.volume()
        self.back_end.settle()

    def mesh(self, resolution: float | None = None) -> trimesh.Trimesh:
        """The observed surface in cells of `resolution` [m], with vertex colours: the map's own, after `finish` those of the archive.

        None: the config's resolution.

        Raises ResultError if nothing was mapped yet, ConfigError if the resolution is not positive.
        """
        cells = self.config.mesh.resolution if resolution is None else resolution
        if not 0 < cells < np.inf:
            raise ConfigError(f"resolution is {resolution}, expected metres above 0, such as {self.config.mesh.resolution}")
        self._check_mapped()
        surface, finer = ImplicitSurface(self.mapper.learnt(), self._volume), self.coverage.finer_views() if self._finished else None
        with ThreadPoolExecutor(1, "archive") as pool:  # it compares the exposures of the images meanwhile
            kept = pool.submit(self.archive) if self._finished else None
            mesh = mesh_of(surface, self.coverage.views(), cells, finer=finer)
        archive = None if kept is None else kept.result()
        return mesh if archive is None or not len(mesh.vertices) else recoloured(mesh, archive)

    def save_map(self, path: Path) -> None:
        """Writes the map as one file, which `idfslam.mapping.saved_map.load_map` reads. Raises ResultError if nothing was mapped yet."""
        self._check_mapped()
        save_map(path, self.mapper.learnt(), self.coverage.views(), self._volume)

    def archive(self) -> ImageArchive | None:
        """The images that views of the map are made of, at the present poses; None if none was kept."""
        if self._archive is not None:
            return self._archive
        statuses = self.statuses()
        kept = [(view, T_wc) for view, T_wc in self.views.posed() if view.index == EARLIER or statuses[view.index].trusted]
        if not kept or self.views.camera is None:
            return None
        archive = archive_of([view for view, _ in kept], self.views.camera, np.stack([T_wc for _, T_wc in kept]))
        self._archive = archive if self._finished else None
        return archive

    def _check_mapped(self) -> None:
        if not self.graph.keyframes:
            raise ResultError(f"nothing is mapped after {len(self.frames)} frames: process at least one frame with depth first")

    def trajectory(self) -> NDArray[np.float64]:
        """(N, 4, 4) camera-to-world poses of all processed frames. Frames move with their keyframes."""
        return self.frames.trajectory()

    def live_trajectory(self) -> NDArray[np.float64]:
        """(N, 4, 4) the reported poses, before later frames, loops and the polish improved them."""
        return self.history.poses()

    def statuses(self) -> list[Status]:
        """The status of each processed frame."""
        return self.frames.statuses()

    @property
    def timings(self) -> dict[str, list[float]]:
        """The durations [ms] of all calls, by stage."""
        return self.timer.milliseconds

    def figures(self) -> dict[str, Any]:
        """What metrics.json reports of the graph: edges and loops (pairs of frames), relocalisations, submaps, finetuning undone."""
        edges = sum(len(keyframe.edges) for keyframe in self.graph.keyframes) // 2
        submaps = len({keyframe.submap for keyframe in self.graph.keyframes})
        return {
            "edges": edges,
            **_FIGURES,
            "submaps": submaps,
            **self.recovery.figures(),
            **self.front_end.figures(),
            **self.back_end.figures(),
            **self.adjustment.figures(),
        }

    def stored_keyframes(self) -> list[StoredKeyframe]:
        """All keyframes in the order in which they were stored, at their present poses."""
        covariances, main = self.adjustment.covariances(), self.graph.main_submap
        told = {main: 0, 0: main}  # the main submap is told as the first
        return [
            StoredKeyframe(
                k.index, k.T_wk.numpy().copy(), frozenset(k.covisible), told.get(k.submap, k.submap), k.camera, covariances.get(k.host)
            )
            for k in self.graph.keyframes
        ]

    def loops(self) -> Sequence[Loop]:
        """The closed loops."""
        return self.back_end.loops()

    def state(self) -> State:
        """The state of the run, without images, collected from its parts (`idfslam.storage.state`)."""
        parts = {name: part.state() for name, part in parts_of(self).items()}
        pending = None if self._pending is None else {"view": self._pending[0].state(), "tracked": self._pending[1].state()}
        return {"graph": self.graph.state(), "pending": pending, "finished": self._finished, "parts": parts}

    def restore(self, state: State, frame: Callable[[int], Frame]) -> None:
        """Takes over `state` in a new Slam of the same config. The run continues as it would have, on the CPU to the last bit.

        frame: returns the processed frame of an index. Raises RecordingError if its images differ.
        """

        def revive(kept: State) -> Keyframe:
            keyframe = self._view(frame(kept["index"]), kept["T_wk"])
            keyframe.rectify_again(kept)
            if keyframe.frame.checksum() != kept["images"]:
                raise RecordingError(f"frame {keyframe.index} has other images than in the run to resume; expected the same recording")
            keyframe.restore(kept)
            return keyframe

        self.graph.restore(state["graph"], revive)
        for name, part in parts_of(self).items():
            part.restore(state["parts"][name])
        pending = state["pending"]
        self._pending = None if pending is None else (revive(pending["view"]), Tracked.from_state(pending["tracked"]))
        self._finished = state["finished"]
