"""Views by image-based rendering over the map: the colours of archived images, at the depth on which these and the map agree."""

from collections import OrderedDict
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from idfslam.geometry.camera import Camera
from idfslam.geometry.pose_distance import apparent_motions
from idfslam.mapping.saved_map import SavedMap
from idfslam.views.blending import BlendedImages, Floats, blended, off_edge
from idfslam.views.constants import AGREES, AGREES_SHARE, MOTION, SAME, SAME_SHARE
from idfslam.views.image_archive import ImageArchive
from idfslam.views.push_pull import push_pull
from idfslam.views.warping import fused_depth

# All of these were chosen by hand.
_NEAREST = 8  # images that lie nearest to the view. More: slower; far ones hardly count
_MOST = 12  # images at most, with those that see what the nearest do not. More: fewer holes, slower
_REDUCED = 4  # [1] the map is rendered in so many times fewer rows and columns. More: faster, coarser where no image has depth
_FUSED = 2  # [1] depth images are fused in so many times fewer rows and columns: they are small themselves. More: faster, coarser
_PLACES = 20  # rows and columns of places at which images are asked what they see. More: small places count, slower
_DECODED = 64  # images kept decoded, 1 MB each. More: videos need less time, more memory
_GAP = 8  # [px] from known colours up to which holes that the map does not show either are filled. More: smears instead of black


@dataclass(frozen=True, eq=False)
class MapViews:
    """Renders views of a map with the images of its run."""

    saved: SavedMap
    archive: ImageArchive
    _decoded: OrderedDict[int, NDArray[np.uint8]] = field(default_factory=OrderedDict, init=False, repr=False)
    _off_edges: dict[int, Floats] = field(default_factory=dict, init=False, repr=False)

    def render(self, T_wc: NDArray[np.float64], camera: Camera) -> tuple[Floats, Floats]:
        """Colour (H, W, 3) in [0, 1] and depth (H, W) [m] for a camera at `T_wc` (4, 4), in the exposure of the images around.

        Black, and depth 0, where neither an image nor the map shows anything. Raises ResultError if an image is damaged.
        """
        coarse = camera.resized(max(1, camera.width // _REDUCED), max(1, camera.height // _REDUCED))
        of_map, depth_of_map = self.saved.render(T_wc, coarse)
        chosen, closeness = self._chosen(T_wc, coarse, depth_of_map)
        images, exposure = self._images(chosen, closeness)
        depth, known = self._depth(T_wc, camera, chosen, closeness, depth_of_map)
        points = _world_points(T_wc, camera, depth)
        colour, weights = blended(points.reshape(-1, 3), T_wc[:3, 3].astype(np.float32), images)
        shown = (weights > 0).reshape(depth.shape)
        colour = colour.reshape(*depth.shape, 3)
        if not shown.all():
            gain, offset = np.exp(exposure[:, 0]), exposure[:, 1]
            known_to_map = _enlarged(depth_of_map, camera) > 0
            recorded = ((_enlarged(of_map, camera, cv2.INTER_LINEAR) + offset) * gain).astype(np.float32)
            shown, colour = _filled(colour, shown, recorded, known_to_map)
        return np.clip(colour, 0, 1), np.where(known & shown, depth, 0).astype(np.float32)

    def _chosen(self, T_wc: NDArray[np.float64], coarse: Camera, depth: Floats) -> tuple[NDArray[np.int64], Floats]:
        """The images to blend (K,), nearest first, and how close each is to the view (K,), 1 for the closest."""
        motion = apparent_motions(T_wc, self.archive.T_wc)
        chosen = list(np.argsort(motion, kind="stable")[:_NEAREST])
        sees = self._sees(T_wc, coarse, depth) if len(motion) > len(chosen) else np.zeros((len(motion), 0), bool)
        open_ = ~sees[chosen].any(0)
        near = np.exp(-motion)
        while len(chosen) < _MOST and open_.any():
            gain = (sees & open_).sum(1) * near
            best = int(gain.argmax())
            if gain[best] <= 0:
                break
            chosen.append(best)
            open_ &= ~sees[best]
        return np.array(chosen), np.exp(-(motion[chosen] - motion.min()) / MOTION).astype(np.float32)

    def _sees(self, T_wc: NDArray[np.float64], coarse: Camera, depth: Floats) -> NDArray[np.bool_]:
        """Whether each image sees each of some places (V, P) of the map in view."""
        step = max(1, coarse.height // _PLACES)
        points = _world_points(T_wc, coarse, depth)[step // 2 :: step, step // 2 :: step].reshape(-1, 3)
        points = points[np.isfinite(points).all(1)].astype(np.float64)
        T_kw, camera = np.linalg.inv(self.archive.T_wc), self.archive.depths[0].camera
        x, y, z = np.moveaxis(points @ T_kw[:, :3, :3].swapaxes(1, 2) + T_kw[:, None, :3, 3], -1, 0)
        ahead = np.maximum(z, 1e-6)
        u, v = np.rint(x / ahead * camera.fx + camera.cx), np.rint(y / ahead * camera.fy + camera.cy)
        inside = (z > 0) & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
        row, column = np.where(inside, v, 0).astype(int), np.where(inside, u, 0).astype(int)
        read = np.stack([view.depth[i, j] for view, i, j in zip(self.archive.depths, row, column)])
        return np.asarray(inside & ((read == 0) | (np.abs(read - z) < AGREES + AGREES_SHARE * z**2)))

    def _images(self, chosen: NDArray[np.int64], closeness: Floats) -> tuple[BlendedImages, NDArray[np.float64]]:
        """The chosen images, brought to one exposure, and that exposure (3, 2): the mean of theirs, the close ones first."""
        a = self.archive
        exposures = a.exposures[chosen]
        exposure = (exposures * closeness[:, None, None]).sum(0) / closeness.sum()
        gains = np.exp(exposure[:, 0] - exposures[..., 0])
        offsets = np.exp(exposure[:, 0]) * (exposure[:, 1] - exposures[..., 1])
        images = BlendedImages(
            a.camera,
            np.stack([self._colour(i) for i in chosen]),
            np.stack([a.depths[i].depth for i in chosen]),
            np.stack([self._off_edge(i) for i in chosen]),
            np.linalg.inv(a.T_wc[chosen])[:, :3].astype(np.float32),
            a.T_wc[chosen, :3, 3].astype(np.float32),
            closeness,
            (gains / 255).astype(np.float32),
            offsets.astype(np.float32),
        )
        return images, exposure

    def _colour(self, i: int) -> NDArray[np.uint8]:
        if i not in self._decoded:
            self._decoded[i] = self.archive.colour(i)
        self._decoded.move_to_end(i)
        while len(self._decoded) > _DECODED:
            self._decoded.popitem(last=False)
        return self._decoded[i]

    def _off_edge(self, i: int) -> Floats:
        if i not in self._off_edges:
            self._off_edges[i] = off_edge(self.archive.depths[i].depth, self.archive.lit)
        return self._off_edges[i]

    def _depth(
        self, T_wc: NDArray[np.float64], camera: Camera, chosen: NDArray[np.int64], closeness: Floats, depth_of_map: Floats
    ) -> tuple[Floats, NDArray[np.bool_]]:
        """Depth (H, W) [m] by the images, the map where these have none, and by what is around elsewhere; and where it is not the last."""
        views = [self.archive.depths[i] for i in chosen]
        T_vk = np.stack([(np.linalg.inv(T_wc) @ view.T_wc)[:3] for view in views]).astype(np.float32)
        half = camera.resized(-(-camera.width // _FUSED), -(-camera.height // _FUSED))
        small = fused_depth(np.stack([view.depth for view in views]), views[0].camera, T_vk, half, closeness)
        depth, smooth = _enlarged(small, camera), _enlarged(small, camera, cv2.INTER_LINEAR)
        depth = np.where(np.abs(smooth - depth) < SAME + SAME_SHARE * depth**2, smooth, depth)
        depth = np.where(depth > 0, depth, _enlarged(depth_of_map, camera))
        known = depth > 0
        inverse = push_pull((1 / np.where(known, depth, 1)).astype(np.float32), known)  # planes have linear inverse depths
        return np.where(known, depth, np.where(inverse > 0, 1 / np.maximum(inverse, 1e-3), 0)).astype(np.float32), known


def without(renderer: MapViews | SavedMap, index: int) -> MapViews | SavedMap:
    """The renderer without the image of a frame, for a fair comparison with that frame; the map alone if no image is left."""
    if not isinstance(renderer, MapViews):
        return renderer
    a = renderer.archive
    left = [i for i, view in enumerate(a.views) if view.index != index]
    if len(left) in (0, len(a.views)):
        return renderer if len(left) else renderer.saved
    return MapViews(renderer.saved, replace(a, views=[a.views[i] for i in left], T_wc=a.T_wc[left], exposures=a.exposures[left]))


def _world_points(T_wc: NDArray[np.float64], camera: Camera, depth: Floats) -> Floats:
    """The points (H, W, 3) [m] in the world of a depth image (H, W) [m]; NaN where it has no depth."""
    rays = (camera.rays(camera.pixels()).numpy() @ T_wc[:3, :3].T.astype(np.float32)).astype(np.float32)
    return rays * np.where(depth > 0, depth, np.float32(np.nan))[..., None] + T_wc[:3, 3].astype(np.float32)


def _enlarged(image: Floats, camera: Camera, interpolation: int = cv2.INTER_NEAREST) -> Floats:
    return np.asarray(cv2.resize(image, (camera.width, camera.height), interpolation=interpolation))


def _filled(colour: Floats, shown: NDArray[np.bool_], of_map: Floats, mapped: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], Floats]:
    """Where there is a colour now (H, W), and the colours (H, W, 3): holes show the map, brought to what is around, or small ones that."""
    both = shown & mapped
    if both.any():
        off = push_pull(np.where(both[..., None], colour - of_map, 0), both)
        colour = np.where(shown[..., None], colour, np.where(mapped[..., None], of_map + off, 0))
        shown = shown | mapped
    if shown.all() or not shown.any():
        return shown, colour
    distance = cv2.distanceTransform((~shown).astype(np.uint8), cv2.DIST_L2, 3)
    small = ~shown & (distance <= _GAP)
    return shown | small, np.where(small[..., None], push_pull(colour, shown), colour)
