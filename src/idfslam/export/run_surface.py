"""The surface of a run: the mesh that the run wrote, and meshes of its map in cells of any size."""

import numpy as np
import trimesh

from idfslam.errors import ConfigError, ResultError
from idfslam.evaluation.evaluate import load_mesh
from idfslam.export import memory_need
from idfslam.export.surface import cleaned
from idfslam.runs import result_folder
from idfslam.runs.finished_run import FinishedRun
from idfslam.views.surface_colour import recoloured

_ROUGH = 0.08  # [m] cells of a mesh that is only measured. Larger: faster, and small objects do not count


def mesh_of_run(run: FinishedRun) -> trimesh.Trimesh | None:
    """mesh.ply of the run, in the run's world; None if there is none."""
    try:
        return load_mesh(result_folder.existing(run.folder, result_folder.MESH))
    except ResultError:
        return None


def surface_area(run: FinishedRun) -> float:
    """The area [m2] of the observed surface."""
    return float((mesh_of_run(run) or run.map.mesh(_ROUGH)).area)


def check_resolution(resolution: float) -> None:
    """Raises ConfigError for a resolution that is no length [m]."""
    if not 0 < resolution < np.inf:
        raise ConfigError(f"--resolution {resolution}, expected metres above 0, such as 0.02")


def mesh_of_map(run: FinishedRun, resolution: float, *, of_map: bool = False) -> trimesh.Trimesh:
    """The surface of the run's map in cells of `resolution` [m], cleaned, in the run's world, in the colours of its archive.

    of_map: in those that the map has learnt.

    Raises ConfigError for a resolution that is no length or needs too much memory, ResultError if the map is missing or has no surface.
    """
    check_resolution(resolution)
    memory_need.check_mesh(surface_area(run), resolution)
    memory_need.log_finest_cells(run.map, resolution)
    mesh = run.map.mesh(resolution)
    if run.archive is not None and not of_map and len(mesh.faces):
        mesh = recoloured(mesh, run.archive)
    if not len(mesh.faces):
        raise ResultError(f"{run.folder}: its map has no surface in cells of {resolution} m; choose a smaller --resolution")
    return cleaned(mesh)
