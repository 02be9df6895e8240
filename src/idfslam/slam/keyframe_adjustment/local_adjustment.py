"""Local bundle adjustment: the newest keyframes and the landmarks that they share, while the camera moves, before the map learns them.

Older keyframes that see the same landmarks stay. So a keyframe of a place that was seen before comes to lie on what was mapped there. The
camera is as stated. Where the images do not agree, nothing moves (`global_adjustment`).
"""

from dataclasses import replace

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from idfslam.adjustment.bundle_adjustment import KINDS, Problem, adjust_briefly, in_motion
from idfslam.adjustment.camera_model import NAMES, CameraModel
from idfslam.adjustment.growing_tracks import GrowingTracks
from idfslam.adjustment.landmark_tracks import KeyframeView
from idfslam.adjustment.observations import Array
from idfslam.adjustment.residuals import camera_points
from idfslam.geometry import se3
from idfslam.geometry.pose_distance import shift_ahead
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.graph.measured_edges import measured_edge
from idfslam.graph.pose_graph import Edge, RelativePoses
from idfslam.slam.keyframe_adjustment.global_adjustment import EDGES, reprojections_agree
from idfslam.slam.keyframe_adjustment.keyframe_motion import KeyframeMotions
from idfslam.slam.keyframe_features import KeyframeFeatures
from idfslam.slam.keyframe_hook import RELEARN_SHIFT, KeyframeHook, Moved
from idfslam.storage.state import State
from idfslam.tracking.frame_features import grey_size

# All of these were chosen by hand.
_WINDOW = 8  # newest keyframes that are adjusted. More: slower, and errors are mended that were made longer ago
_SEARCHED = 6  # older keyframes whose landmarks are looked for in a new one. More: longer tracks, slower
_STEPS = 3  # of an adjustment. More: slower, more exact
_LEAST_LANDMARKS = 50  # that the window shares. More: keyframes before bare walls stay as they are
_FARTHEST = 0.05  # [m] largest shift of a point 2 m before a keyframe: so large a step is wrong. More: larger errors are mended, and made


class LocalAdjustment(KeyframeHook):
    """Adjusts the newest keyframes of a graph."""

    def __init__(self, graph: KeyframeGraph, features: KeyframeFeatures, motions: KeyframeMotions | None = None) -> None:
        """motions: how the keyframes moved; None: their images are of one moment."""
        self.graph, self.features, self.motions, self.tracks = graph, features, motions, GrowingTracks()
        self._held: set[int] = set()  # numbers of the keyframes that landmarks hold
        self._edges: dict[int, Edge] = {}  # from a keyframe before each to it, as it was tracked
        self._noise = np.ones(len(KINDS))  # in the last window, over the stated one, by kind of measurement
        self.agrees = True  # whether the images of the last window agreed
        self._distant: tuple[int, Array, Array] = -1, np.zeros((0, 2)), np.zeros(0)  # of `distant`: keyframe, uv and depth
        self._images: dict[int, list[float]] = {}  # how those of each keyframe were rectified when landmarks were found in them

    def state(self) -> State:
        """All but the tracks, which are a part of their own."""
        edges = {str(b): {"a": edge.a, "T_ab": edge.T_ab} for b, edge in self._edges.items()}
        images = {str(k): times for k, times in self._images.items()}
        number, *arrays = self._distant
        return {
            "held": sorted(self._held),
            "edges": edges,
            "images": images,
            "noise": self._noise.tolist(),
            "agrees": self.agrees,
            "distant": [number, *(torch.from_numpy(array.copy()) for array in arrays)],
        }

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        self._held = set(state["held"])
        self._edges = {int(b): measured_edge(edge["a"], int(b), edge["T_ab"], EDGES) for b, edge in state["edges"].items()}
        self._noise, self.agrees = np.array(state["noise"]), state["agrees"]
        self._images = {int(k): list(times) for k, times in state["images"].items()}
        number, *arrays = state["distant"]
        self._distant = number, arrays[0].numpy().copy(), arrays[1].numpy().copy()

    def distant(self, number: int) -> tuple[Array, Array]:
        """Where keyframe `number` shows landmarks without depth, uv (N, 2) [px], and their depth (N,) [m] as the last window has it."""
        return self._distant[1:] if self._distant[0] == number else (np.zeros((0, 2)), np.zeros(0))

    def holds(self, keyframe: Keyframe) -> bool:
        """Whether a stored keyframe lies where landmarks want it, and is not to be moved by others."""
        return keyframe.host in self._held

    def on_split(self) -> None:
        self.tracks.separate([keyframe.submap for keyframe in self.graph.keyframes])

    def on_keyframe(self, keyframe: Keyframe) -> Moved:
        if not self.graph.is_stored(keyframe):
            return Moved()  # a culled one has no landmarks
        self._forget_changed()
        poses = torch.stack([k.T_wk for k in self.graph.keyframes]).numpy()
        self._add(keyframe, poses)
        problem, numbers = self._problem(self._window(keyframe), poses)
        if len(problem.points) < _LEAST_LANDMARKS or problem.fixed.all():
            return Moved()
        adjusted, self._noise = adjust_briefly(problem, noise=self._noise, steps=_STEPS)
        with_depth = adjusted.seen[~adjusted.seen.distant]
        self.agrees = len(with_depth) > 0 and reprojections_agree(with_depth, problem.model.stated.width)
        if not self.agrees:
            return Moved()
        seen = adjusted.seen[adjusted.seen.distant & (numbers[adjusted.seen.keyframe] == keyframe.host)]
        depth = camera_points(adjusted.poses, adjusted.points, seen)[:, 2]
        self._distant = keyframe.host, seen.uv[depth > 0], depth[depth > 0]
        return self._move(numbers[~problem.fixed], adjusted.poses[~problem.fixed])

    def _forget_changed(self) -> None:
        """Forgets the landmarks of keyframes whose images were rectified anew since."""
        for number, times in list(self._images.items()):
            if times != _rectified(self.graph.keyframes[number]):
                self.tracks.forget(number)
                del self._images[number]

    def hide(self, keyframe: Keyframe) -> None:
        """Forgets the landmarks that a stored keyframe shows on what moves, as is known by now."""
        if keyframe.moving is not None:
            columns, rows = grey_size(keyframe.camera)[::-1]
            moving = cv2.resize(keyframe.moving.astype(np.uint8), (columns, rows), interpolation=cv2.INTER_NEAREST)
            self.tracks.hide(keyframe.host, moving > 0)

    def _add(self, keyframe: Keyframe, poses: Array) -> None:
        """Looks for landmarks in a new keyframe."""
        features, number, view = self.features.images_of(keyframe), keyframe.host, KeyframeView.of(keyframe.frame, keyframe.moving)
        older = _spread([i for i in keyframe.edges if i < number])
        others = [(i, self.features.images_of(self.graph.keyframes[i]), np.linalg.inv(poses[i]) @ poses[number]) for i in older]
        self.tracks.add(number, features, view, others, CameraModel.as_stated(features.grey_camera))
        self._images[number] = _rectified(keyframe)
        if older:
            self._edges[number] = measured_edge(older[0], number, torch.from_numpy(others[0][2]), EDGES)

    def _window(self, keyframe: Keyframe) -> NDArray[np.bool_]:
        """(K,) the newest keyframes, of the same submap."""
        chosen = np.array([k.submap == keyframe.submap for k in self.graph.keyframes])
        chosen[: max(0, keyframe.host + 1 - _WINDOW)] = False
        return chosen

    def _problem(self, window: NDArray[np.bool_], poses: Array) -> tuple[Problem, NDArray[np.int64]]:
        """The problem of a window (K,), and the numbers of its keyframes."""
        keyframes = self.graph.keyframes
        points, seen = self.tracks.seen_by(window, poses)
        edges = [edge for b, edge in self._edges.items() if window[b] and keyframes[edge.a].submap == keyframes[b].submap]
        numbers = np.unique([*seen.keyframe.tolist(), *np.flatnonzero(window).tolist(), *(edge.a for edge in edges)])
        places = {int(number): place for place, number in enumerate(numbers)}
        relative = [replace(edge, a=places[edge.a], b=places[edge.b]) for edge in edges]
        begins = np.array([keyframes[i].host == keyframes[i].submap for i in numbers])
        model = CameraModel.as_stated(self.features.images_of(keyframes[-1]).grey_camera)
        seen = replace(seen, keyframe=np.searchsorted(numbers, seen.keyframe))
        none = np.zeros(len(NAMES), bool)
        between = RelativePoses.of(relative) if relative else None
        problem = Problem(model, poses[numbers], points, seen, ~window[numbers] | begins, none, between)
        if self.motions is not None:
            problem = in_motion(problem, [self.motions.of(keyframes[i]) for i in numbers])
        return problem, numbers

    def _move(self, numbers: NDArray[np.int64], poses: Array) -> Moved:
        moved = list[Keyframe]()
        for number, T in zip(numbers.tolist(), poses):
            keyframe, T_wk = self.graph.keyframes[number], se3.orthonormal(torch.from_numpy(T.copy()))
            change = se3.inverse(keyframe.T_wk) @ T_wk
            shift = shift_ahead(change)
            if shift > _FARTHEST:
                continue
            self.graph.set_pose(keyframe, T_wk)
            self._held.add(number)
            if shift > RELEARN_SHIFT:
                moved.append(keyframe)
        return Moved(moved)


def _spread(older: list[int]) -> list[int]:
    """The newest and the oldest of some keyframes, and some between, the newest first."""
    ordered = sorted(older, reverse=True)
    return [ordered[i] for i in np.unique(np.linspace(0, len(ordered) - 1, min(_SEARCHED, len(ordered))).round().astype(int))]


def _rectified(keyframe: Keyframe) -> list[float]:
    """What a keyframe's images are rectified with, as numbers; none where they are as they were taken."""
    if keyframe.rectification is None:
        return []
    times = keyframe.rectification.times
    return [times.readout, times.depth_readout, times.depth_delay, *map(float, keyframe.rectification.velocity)]
