"""The pictures of a report: the mesh from outside and inside, the room's plan, slices of the map, and frames next to the rendered map."""

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import cv2
import matplotlib as mpl
import numpy as np
import torch
import trimesh
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from idfslam.datasets import Dataset
from idfslam.errors import FrameError
from idfslam.evaluation.view_error import psnr
from idfslam.export.tsdf_grid import observed_space
from idfslam.geometry.camera import Camera
from idfslam.geometry.even_spacing import evenly_spread
from idfslam.geometry.level import from_above
from idfslam.graph.coverage import EARLIER
from idfslam.mapping.saved_map import SavedMap
from idfslam.pictures.direction import best_direction, shown
from idfslam.pictures.image_files import to_bytes
from idfslam.pictures.mesh_renderer import Lighting, Picture, pose_outside
from idfslam.pictures.scraps import without_scraps
from idfslam.report.figures import Plan
from idfslam.sensing.matched_exposure import matched_exposure
from idfslam.views.image_archive import ImageArchive
from idfslam.views.image_based_rendering import MapViews, without

Floats = NDArray[np.float64]
Image = NDArray[np.uint8]

_OUTSIDE = Camera(640, 480, 700.0, 700.0, 319.5, 239.5)
_INSIDE = Camera(640, 440, 380.0, 380.0, 319.5, 219.5)  # wide: 80 degrees
_PLAN_PIXELS = 640  # along the longer side
_SLICE_CELL = 0.02  # [m]
_MARGIN = 0.15  # [m] around the room
_FAR = 30.0  # height of the plan's camera, in sizes of the room; larger: closer to a parallel projection
_HEIGHTS = (0.25, 0.5, 0.75)  # of the slices, as shares of the room's height
_WIDTH = 320  # [px] of a frame's pictures; larger: sharper, and a larger page
_FRAMES = 4
_LEAST_SIDE = 0.3  # [1] of what the best side shows of the surface, below which a side is left out. More: fewer pictures. Chosen by hand
_AT_ONCE = 2  # pictures drawn in parallel; more: faster on more cores, 100 MB of memory each
_MOVING = (225, 29, 72)  # RGB over what moves
_COVER = 0.55  # [1] of that colour over the image. More: less of the image shows
_LEAST_MOVING = 0.005  # [1] share of an image that must move for it to be shown. More: fewer pictures. Chosen by hand
_MOVING_FRAMES = 8  # images that show what moves. More: a longer strip
_MAX_ERROR = 0.05  # [m] depth error at the end of the colour scale


class RoomPictures:
    """A mesh with the cameras that saw it. Its methods draw the pictures of the room."""

    def __init__(self, mesh: trimesh.Trimesh, poses: Floats, R_lw: Floats) -> None:
        self._mesh, self._poses, self._R_lw = (mesh := without_scraps(mesh)), poses, R_lw
        self._picture = Picture(mesh, inside=poses[:, :3, 3])
        local = np.concatenate([np.percentile(np.asarray(mesh.vertices) @ R_lw.T, [0.3, 99.7], axis=0), poses[:, :3, 3] @ R_lw.T])
        margin = np.array([_MARGIN, _MARGIN, 0])
        self.low, self.high = local.min(0) - margin, local.max(0) + margin

    def outside(self) -> list[Image]:
        """Pictures (H, W, 4) from the best side and at right angles to it, without sides that hardly show what the cameras saw."""
        up, eyes = self._R_lw[2], self._poses[:, :3, 3]
        turns = Rotation.from_rotvec(np.arange(4)[:, None] * np.pi / 2 * up).as_matrix()
        directions = turns @ best_direction(self._mesh, eyes, up)
        seen = shown(self._mesh, eyes, directions)
        chosen = directions[seen >= _LEAST_SIDE * seen[0]]
        return self._seen([pose_outside(self._mesh, up, direction, _OUTSIDE) for direction in chosen], _OUTSIDE, Lighting())

    def inside(self) -> list[Image]:
        """Wide-angle pictures (H, W, 4) from four places on the path."""
        lit = Lighting(occlusion=0)  # occlusion would take most of the report's time: here every pixel shows surface
        return self._seen([self._poses[i] for i in _between_ends(len(self._poses), 4)], _INSIDE, lit)

    def _seen(self, poses: Sequence[Floats], camera: Camera, lighting: Lighting) -> list[Image]:
        """Draws in parallel threads: ray casting and arithmetic on whole images release the interpreter."""
        with ThreadPoolExecutor(_AT_ONCE) as pool:
            return list(pool.map(lambda T_wc: self._picture.cut_out(T_wc, camera, lighting), poses))

    def plan(self) -> Plan:
        """The room from above. The ceiling is invisible from outside."""
        size = self.high - self.low
        per_metre = _PLAN_PIXELS / size[:2].max()
        width, height = (max(8, round(float(x * per_metre))) for x in size[:2])
        above = _FAR * float(size.max())
        focal = per_metre * above
        camera = Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)
        image = self._picture.cut_out(from_above(self._R_lw, (self.low + self.high) / 2, above), camera, Lighting())
        return Plan(image, (self.low[0], self.high[0], self.low[1], self.high[1]))

    def slices(self, saved: SavedMap) -> Iterator[tuple[float, Plan]]:
        """Heights above the lowest surface [m], each with the signed distance [m] on that plane, NaN where nothing was observed."""
        x, y = (np.arange(self.low[a], self.high[a], _SLICE_CELL) for a in (0, 1))
        tr, device, sdf = saved.surface.truncation, next(saved.field.parameters()).device, saved.surface.sdf
        for share in _HEIGHTS:
            z = self.low[2] + share * (self.high[2] - self.low[2])
            local = np.stack(np.broadcast_arrays(x[None, :], y[::-1, None], z), -1)
            points = (local.reshape(-1, 3) @ self._R_lw).astype(np.float32)
            with torch.no_grad():
                distance = sdf(torch.from_numpy(points).to(device)).clamp(-1, 1).cpu().numpy() * tr
            distance[~observed_space(points, saved.views, tr)] = np.nan
            yield z - self.low[2], Plan(distance.reshape(local.shape[:2]), (x[0], x[-1], y[0], y[-1]))


@dataclass(frozen=True, eq=False)
class RenderedComparison:
    """A frame next to the map rendered from its pose."""

    index: int
    pictures: dict[str, Image]  # (h, w, 3) by caption
    psnr: float  # [dB] of the colour, at the exposure of the frame
    depth_error: float  # [m] median, where both have depth


def moving_strip(archive: ImageArchive) -> list[tuple[str, Image]]:
    """Captions and pictures (h, w, 3) of images of the archive in which something moves, spread over the run, with that in red."""
    shares = np.array([(view.depth < 0).mean() for view in archive.depths])
    found = [i for i in np.argsort([view.index for view in archive.views], kind="stable") if shares[i] >= _LEAST_MOVING]
    strip = []
    for i in (found[k] for k in evenly_spread(len(found), _MOVING_FRAMES)):
        colour, moving = archive.colour(i).astype(np.float32), archive.moving(i)[..., None]
        shown = np.where(moving, (1 - _COVER) * colour + _COVER * np.array(_MOVING, np.float32), colour)
        size = (_WIDTH, round(_WIDTH * archive.camera.height / archive.camera.width))
        picture = cv2.resize(shown, size, interpolation=cv2.INTER_AREA)
        index = archive.views[i].index
        name = "Image of the earlier run" if index == EARLIER else f"Frame {index}"
        strip.append((f"{name}: {shares[i]:.0%} moves", to_bytes(picture / 255)))
    return strip


def _between_ends(count: int, wanted: int) -> list[int]:
    """`wanted` indices evenly spread over `count`, without the two ends."""
    return sorted({round(float(i)) for i in np.linspace(0, count - 1, wanted + 2)[1:-1]})


def comparisons(renderer: MapViews | SavedMap, recording: Dataset, poses: Sequence[Floats] | Floats) -> Iterator[RenderedComparison]:
    """Comparisons of frames at poses (N, 4, 4), spread over the run, rendered without their own images; none of unreadable frames."""
    own = recording.camera
    small = own.resized(_WIDTH, round(_WIDTH * own.height / own.width))
    for i in _between_ends(len(poses), _FRAMES):
        try:
            frame = recording[i]
        except FrameError:
            continue
        colour, depth = without(renderer, i).render(poses[i], small)
        size = (small.width, small.height)
        seen = np.asarray(cv2.resize(frame.colour, size, interpolation=cv2.INTER_AREA), np.float32)
        measured = np.asarray(cv2.resize(frame.depth, size, interpolation=cv2.INTER_NEAREST))
        both = (measured > 0) & (depth > 0)
        error = np.where(both, np.abs(depth - measured), np.nan)
        far = float(np.percentile(measured[measured > 0], 99)) if (measured > 0).any() else 1.0
        surface = depth > 0
        shown = matched_exposure(colour, seen, surface)
        pictures = {
            "colour, recorded": to_bytes(seen),
            "colour, map": to_bytes(shown),
            "depth, recorded": _painted(np.where(measured > 0, measured, np.nan) / far, "viridis"),
            "depth, map": _painted(np.where(depth > 0, depth, np.nan) / far, "viridis"),
            "depth error": _painted(error / _MAX_ERROR, "magma"),
        }
        quality = psnr(shown[surface], seen[surface]) if surface.any() else 0.0
        yield RenderedComparison(i, pictures, quality, float(np.nanmedian(error)) if both.any() else float("nan"))


def _painted(values: NDArray[np.floating], colours: str) -> Image:
    """Values (H, W) in [0, 1] in the colours of a colour map; NaN is grey."""
    rgb = np.asarray(mpl.colormaps[colours](np.clip(np.nan_to_num(values), 0, 1)))[..., :3]
    return to_bytes(np.where(np.isnan(values)[..., None], 0.5, rgb))
