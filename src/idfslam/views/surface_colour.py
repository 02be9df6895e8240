"""The colours of a surface from images: for the vertices of meshes, and for textures.

Near, frontal images count most. An image whose colour differs from the mean of all counts less in a second round: what moved, reflections,
and places that lie beside their images.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
import trimesh
from numpy.typing import NDArray

from idfslam.compute.ahead import ahead
from idfslam.compute.backend import pick
from idfslam.frame import Frame
from idfslam.geometry.camera import Camera
from idfslam.geometry.projection import intrinsics_of
from idfslam.views.blending import Floats, off_edge, seen_in_image
from idfslam.views.constants import LEAST_COSINE, OUTLIER, SHARPNESS
from idfslam.views.image_archive import ImageArchive

Shade = Callable[[Floats, Floats], Floats]  # points (N, 3) [m], unit normals (N, 3) -> RGB (N, 3) in [0, 1]


@dataclass(frozen=True, eq=False)
class PosedColours:
    """An image of the surface."""

    colour: NDArray[np.uint8]  # (H, W, 3)
    depth: Floats  # (h, w) [m], 0: no reading
    camera: Camera  # of colour
    T_wc: NDArray[np.float64]  # (4, 4)
    lit: NDArray[np.bool_] | None  # (H, W) the pixels that the camera fills; None: all
    gain: Floats  # (3,), and
    offset: Floats  # (3,): gain * colour / 255 + offset has the exposure of all


def of_archive(archive: ImageArchive) -> Iterator[PosedColours]:
    """The images of an archive, in the median of their exposures."""
    median, depths = np.median(archive.exposures, 0), archive.depths

    def posed(i: int) -> PosedColours:
        gain = np.exp(median[:, 0] - archive.exposures[i, :, 0])
        offset = np.exp(median[:, 0]) * (median[:, 1] - archive.exposures[i, :, 1])
        shown = gain.astype(np.float32), offset.astype(np.float32)
        return PosedColours(archive.colour(i), depths[i].depth, archive.camera, depths[i].T_wc, archive.lit, *shown)

    return ahead(posed, range(len(depths)))


def of_frames(frames: Iterable[tuple[Frame, NDArray[np.float64]]]) -> Iterator[PosedColours]:
    """Frames with their T_wc (4, 4), as they were exposed."""
    for frame, T_wc in frames:
        colour = (frame.colour * 255 + 0.5).astype(np.uint8)
        yield PosedColours(colour, frame.depth, frame.camera, T_wc, None, np.ones(3, np.float32), np.zeros(3, np.float32))


def from_images(images: Callable[[], Iterable[PosedColours]], otherwise: Shade) -> Shade:
    """Colours from images, which are gone through twice. `otherwise` colours the points that none of them sees."""

    def shade(points: Floats, normals: Floats) -> Floats:
        colours, seen = seen_colours(points, normals, images)
        if not seen.all():
            colours[~seen] = otherwise(points[~seen], normals[~seen])
        return colours

    return shade


def seen_colours(points: Floats, normals: Floats, images: Callable[[], Iterable[PosedColours]]) -> tuple[Floats, NDArray[np.bool_]]:
    """The colours (N, 3) in [0, 1] of points (N, 3) [m] with unit normals (N, 3), and which of them an image sees (N,)."""
    points, normals = np.ascontiguousarray(points, np.float32), np.ascontiguousarray(normals, np.float32)
    mean, _ = _mean(points, normals, images(), None)
    mean, seen = _mean(points, normals, images(), mean)
    return np.clip(mean, 0, 1), seen


def as_exposed(archive: ImageArchive, scene: NDArray[np.floating]) -> Floats:
    """Colours of the scene (N, 3), as the map learns them, in the exposure of `of_archive`."""
    median = np.median(archive.exposures, 0)
    return np.clip((scene + median[:, 1]) * np.exp(median[:, 0]), 0, 1).astype(np.float32)


def recoloured(mesh: trimesh.Trimesh, archive: ImageArchive) -> trimesh.Trimesh:
    """The mesh with the archive's colours at its vertices. A vertex that no image sees keeps its own, in their exposure."""
    visual: Any = mesh.visual
    own = np.asarray(visual.vertex_colors[:, :3], np.float32) / np.float32(255)
    normals = np.asarray(mesh.vertex_normals, np.float32)
    colours, seen = seen_colours(np.asarray(mesh.vertices, np.float32), normals, lambda: of_archive(archive))
    colours[~seen] = as_exposed(archive, own[~seen])
    shown = (colours * 255 + 0.5).astype(np.uint8)
    return trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_normals=mesh.vertex_normals, vertex_colors=shown, process=False)


def _mean(points: Floats, normals: Floats, images: Iterable[PosedColours], expected: Floats | None) -> tuple[Floats, NDArray[np.bool_]]:
    """The weighted mean (N, 3) of the colours of points (N, 3), and where there is one (N,). expected: the mean of a round before."""
    total, weights = np.zeros((len(points), 3), np.float32), np.zeros(len(points), np.float32)
    gather = pick(torch.empty(0), compiled=compiled_gather, plain=plain_gather)
    for image in images:
        gather(points, normals, image, expected, total, weights)
    seen = weights > 0
    return total / np.maximum(weights, np.float32(1e-30))[:, None], seen


def compiled_gather(points: Floats, normals: Floats, image: PosedColours, expected: Floats | None, total: Floats, weights: Floats) -> None:
    """Adds the weighted colours of points (N, 3), with normals (N, 3), in an image to total (N, 3), and the weights to weights (N,).

    expected (N, 3): what differs from it counts less; None: nothing is expected.
    """
    from idfslam.views.kernels import numba_surface

    compared, scale = (total, np.float32(np.inf)) if expected is None else (expected, np.float32(OUTLIER))
    T_cw, centre = np.linalg.inv(image.T_wc)[:3].astype(np.float32), image.T_wc[:3, 3].astype(np.float32)
    intrinsics = np.array(intrinsics_of(image.camera), np.float32)
    shown = image.colour, image.depth, off_edge(image.depth, image.lit), image.gain / np.float32(255), image.offset
    numba_surface.gather(points, normals, T_cw, centre, intrinsics, *shown, compared, scale, total, weights)


def plain_gather(points: Floats, normals: Floats, image: PosedColours, expected: Floats | None, total: Floats, weights: Floats) -> None:
    """`compiled_gather` in numpy."""
    T_cw = np.linalg.inv(image.T_wc)[:3].astype(np.float32)
    weight, colour = seen_in_image(points, T_cw, image.camera, image.colour, image.depth, off_edge(image.depth, image.lit), 0.0)
    colour = colour * image.gain / np.float32(255) + image.offset
    towards = image.T_wc[:3, 3].astype(np.float32) - points
    distance = np.linalg.norm(towards, axis=1)
    cosine = (towards * normals).sum(1) / distance
    weight = np.where(cosine < LEAST_COSINE, 0, weight * (np.maximum(cosine, 0) / distance) ** SHARPNESS)
    if expected is not None:
        weight = weight / (1 + ((colour - expected) ** 2).sum(1) / OUTLIER**2)
    total += (weight[:, None] * colour).astype(np.float32)
    weights += weight.astype(np.float32)
