"""The surface of a run with a texture: from the images of its recording or its archive, or from the colours of the map."""

from collections.abc import Callable, Iterable

import numpy as np
import torch
import trimesh

from idfslam.export.formats import Texture
from idfslam.export.images import PosedImage
from idfslam.export.texture import textured
from idfslam.mapping.saved_map import SavedMap
from idfslam.runs.finished_run import FinishedRun
from idfslam.views.blending import Floats
from idfslam.views.surface_colour import as_exposed, from_images, of_archive, of_frames

_POINTS = 1 << 18  # that the map colours at a time; raised, more memory. Chosen by hand


def with_texture(
    mesh: trimesh.Trimesh, run: FinishedRun, texture: Texture, images: Callable[[], Iterable[PosedImage]] | None
) -> trimesh.Trimesh:
    """A mesh of the run, in its world, with a texture. images: those that colour it, as often as they are asked for; None: the archive's,
    which must be there.

    What no image sees has the map's colour, at the exposure of the archive's images where these colour the rest.
    """

    def of_map(points: Floats, normals: Floats) -> Floats:
        return _map_colour(run.map, points, normals)

    if texture == "map":
        return textured(mesh, of_map)
    if images is not None:
        return textured(mesh, from_images(lambda: of_frames((image.frame, image.T_wc) for image in images()), of_map))
    archive = run.archive
    assert archive is not None

    def of_exposed_map(points: Floats, normals: Floats) -> Floats:
        return as_exposed(archive, of_map(points, normals))

    return textured(mesh, from_images(lambda: of_archive(archive), of_exposed_map))


@torch.no_grad()
def _map_colour(saved: SavedMap, points: Floats, normals: Floats) -> Floats:
    """The map's colour of points, seen along their normals."""
    field = saved.field
    device = next(field.parameters()).device
    chunks = (torch.from_numpy(np.ascontiguousarray(array)).to(device).split(_POINTS) for array in (points, -normals))
    directed = field.direction_encoding is not None
    return torch.cat([field(p, d if directed else None)[1].cpu() for p, d in zip(*chunks)]).numpy()
