"""Landmarks seen in many keyframes: patches of one, found in others to a fraction of a pixel, with depth where there is a surface.

Each keyframe hosts the landmarks of its own patches. They are looked for in keyframes that see the same surface, some of them from nearby
and some from as far away as possible. Where poses and camera are not yet exact, a pair is first aligned coarse to fine.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from idfslam.adjustment.camera_model import CameraModel
from idfslam.adjustment.local_depth import local_depth
from idfslam.adjustment.observations import Array, Indices, Observations, determined, joined, together
from idfslam.adjustment.patch_search import root_of, search
from idfslam.frame import Frame
from idfslam.geometry.camera import Camera
from idfslam.graph.covisibility import covisibility
from idfslam.tracking.frame_features import FrameFeatures, averaged_depth, brightness, subsampled_depth
from idfslam.tracking.patch_alignment import aligned_patches
from idfslam.tracking.patches import Patches

_ROWS = 120  # [px] of the image of points that patches get their planes from, as the tracker has it; more: planes of smaller surfaces
_COVISIBLE = 0.25  # [1] least share of a keyframe that a partner sees; raised, fewer and surer pairs. This and the rest: chosen by hand
_PARTNERS = 10  # most keyframes that a keyframe's patches are looked for in; more: longer tracks, slower
_NEAR_SURFACE = 0.05  # [1] largest difference of a landmark's depth to the reading where it is found; raised, hidden ones are found wrongly
_APART = 6  # [px] least distance of two landmarks in an image, along a row or column; more: fewer, and their patches overlap less


@dataclass(frozen=True, eq=False)
class KeyframeView:
    """A keyframe's images, of at most 480 rows, as the camera states them."""

    grey: NDArray[np.uint8]  # (H, W)
    depth: NDArray[np.float32]  # (H, W) [m], 0: no reading
    camera: Camera
    moving: NDArray[np.bool_] | None = None  # (H, W) what moves; None: nothing

    @staticmethod
    def of(frame: Frame, moving: NDArray[np.bool_] | None = None) -> "KeyframeView":
        """The view of a frame, of which the pixels `moving` (H, W) show what moves."""
        grey = brightness(frame)
        size = grey.shape[1], grey.shape[0]
        if size == (frame.camera.width, frame.camera.height):
            return KeyframeView(grey, frame.depth, frame.camera, moving)
        hidden = None if moving is None else cv2.resize(moving.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
        return KeyframeView(grey, subsampled_depth(frame.depth, size[1], size[0]), frame.camera.resized(*size), hidden)


def find_tracks(
    views: Sequence[KeyframeView],
    images: Sequence[FrameFeatures],
    poses: Array,
    model: CameraModel,
    *,
    recordings: Indices | None = None,
    coarse: bool,
) -> tuple[Array, Observations]:
    """Landmarks (L, 3) [m] in the world, and where keyframes at poses T_wk (K, 4, 4) see them. images: `features_of` views and model.

    recordings: (K,) numbers of the recordings that the keyframes are of, each of which has a world of its own; None: there is one.
    coarse: poses and camera may be wrong by up to about 20 pixels rather than by 5.
    """
    of = np.zeros(len(views), np.int64) if recordings is None else recordings
    taken, found = [Taken(view.grey.shape) for view in views], list[tuple[Array, Observations]]()
    for k in range(len(views)):
        patches = images[k].patches
        patches = patches[torch.from_numpy(np.flatnonzero(taken[k].free(patches.uv.numpy())))]
        points, seen = _hosted(k, patches, images, poses, model, _partners(k, images, poses, of == of[k]), coarse=coarse)
        for j in range(len(views)):
            taken[j].take(seen.uv[seen.keyframe == j])
        found.append((points, seen))
    points, seen = together(found)
    seen = with_readings(views, seen)
    return determined(points, seen[seen.reading > 0])  # without a surface all around, what is in front of it moves in the patch too


class Taken:
    """Where an image shows landmarks already: a second one of the same pixels would count their noise twice."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        self._taken = np.zeros(shape, bool)

    def free(self, uv: Array) -> NDArray[np.bool_]:
        """(N,) whether no landmark is near pixels (N, 2)."""
        u, v = np.rint(uv).astype(np.int64).T
        return ~self._taken[v, u]

    def take(self, uv: Array) -> None:
        """Landmarks are seen at pixels (N, 2)."""
        for u, v in np.rint(uv).astype(np.int64):
            self._taken[max(v - _APART, 0) : v + _APART + 1, max(u - _APART, 0) : u + _APART + 1] = True


def features_of(view: KeyframeView, model: CameraModel) -> FrameFeatures:
    """The images of a view with points as the model has them, without features of the network."""
    depth = model.deformation.corrected(view.depth * np.float32(model.depth_factor))
    height = min(_ROWS, view.camera.height)
    width = round(view.camera.width * height / view.camera.height)
    camera = model.camera.resized(width, height)
    points = camera.backproject(torch.from_numpy(averaged_depth(depth, height, width)))
    return FrameFeatures(torch.zeros(0, 0, 0), torch.zeros(3, height, width), points, camera, model.camera, torch.from_numpy(view.grey))


def _partners(k: int, images: Sequence[FrameFeatures], poses: Array, candidates: NDArray[np.bool_]) -> list[int]:
    """The keyframes, among candidates (K,), that keyframe k's patches are looked for in: all ranks of covisibility have some."""
    T = torch.from_numpy(np.linalg.inv(poses) @ poses[k])
    depths = [image.points[..., 2] for image in images]
    shares = covisibility(depths[k], images[k].camera, T, [image.camera for image in images], depths, subsample=4)
    shares[k] = 0
    shares[torch.from_numpy(~candidates)] = 0
    order = torch.argsort(shares, descending=True, stable=True)
    near = order[shares[order] > _COVISIBLE].tolist()
    return [near[i] for i in np.unique(np.linspace(0, len(near) - 1, min(_PARTNERS, len(near))).round().astype(int))]


def _hosted(
    k: int, patches: Patches, images: Sequence[FrameFeatures], poses: Array, model: CameraModel, partners: Sequence[int], *, coarse: bool
) -> tuple[Array, Observations]:
    """The landmarks (L, 3) [m] of those of keyframe k's patches that are found in any partner, and their sightings, without readings."""
    found = []
    for j in partners:
        T_jk = np.linalg.inv(poses[j]) @ poses[k]
        if coarse and (better := aligned_patches(torch.from_numpy(np.linalg.inv(T_jk)), images[j], images[k])) is not None:
            T_jk = np.linalg.inv(better[0].numpy())
        found.append((j, *found_in(patches, images[k], images[j], T_jk, model)))
    counts, own = np.zeros(len(patches)), np.zeros((len(patches), 2, 2))
    for _, at, _, covariance in found:
        counts[at] += 1
        own[at] += covariance
    seen, number, T = np.flatnonzero(counts), np.cumsum(counts > 0) - 1, poses[k]
    parts = [sightings(k, np.arange(len(seen)), patches.uv.numpy()[seen], own[seen] / counts[seen, None, None])]
    parts += [sightings(j, number[at], uv, covariance) for j, at, uv, covariance in found]
    return patches.points.numpy()[seen] @ T[:3, :3].T + T[:3, 3], joined(parts)


def sightings(keyframe: int, landmark: Indices, uv: Array, covariance: Array) -> Observations:
    """What a keyframe sees of landmarks (N,), without readings: at pixels uv (N, 2), with this covariance (N, 2, 2)."""
    n = len(landmark)
    return Observations(np.full(n, keyframe, np.int64), landmark, uv, root_of(covariance), np.zeros(n), np.ones(n), np.zeros((n, 2)))


def found_in(patches: Patches, host: FrameFeatures, other: FrameFeatures, T_oh: Array, model: CameraModel) -> tuple[Indices, Array, Array]:
    """Which patches (M,) of a host are found in another view at T_oh (4, 4), where, uv (M, 2), and the covariance (M, 2, 2) of that."""
    found = search(patches, host.grey, other.grey, T_oh, model)
    good = _on_surface(torch.from_numpy(found.uv), torch.from_numpy(found.z), other).numpy()
    return found.patch[good], found.uv[good], found.covariance[good]


def _on_surface(uv: torch.Tensor, z: torch.Tensor, view: FrameFeatures) -> torch.Tensor:
    """Whether points at pixels uv (N, 2) and depths z (N,) [m] are not far from the view's surface; yes where it has no reading."""
    depth = view.points[..., 2].double()
    size = torch.tensor([depth.shape[1], depth.shape[0]])
    scale = size / torch.tensor([view.grey.shape[1], view.grey.shape[0]])
    u, v = ((uv + 0.5) * scale - 0.5).round().long().clamp(min=0).minimum(size - 1).unbind(-1)
    return (depth[v, u] == 0) | ((depth[v, u] - z).abs() < _NEAR_SURFACE * z)


def with_readings(views: Sequence[KeyframeView], seen: Observations) -> Observations:
    """The sightings, sorted, with the depth that the keyframes state where they see a landmark."""
    reading, sigma, slope = np.zeros(len(seen)), np.ones(len(seen)), np.zeros((len(seen), 2))
    for k, view in enumerate(views):
        chosen = seen.keyframe == k
        if chosen.any():
            reading[chosen], sigma[chosen], slope[chosen] = local_depth(view.depth, seen.uv[chosen])
    return replace(seen, reading=reading, reading_sigma=sigma, slope=slope)[np.lexsort((seen.keyframe, seen.landmark))]
