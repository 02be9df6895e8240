"""What can be made of a saved map: a mesh at any resolution, pictures from the trajectory's frames."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from idfslam import results
from idfslam.errors import ConfigError, ResultError
from idfslam.geometry.trajectory import load_tum
from idfslam.mapping.saved_map import load_map
from idfslam.pictures import write_colour, write_depth

MESH_FORMATS = (".ply", ".obj", ".off", ".stl", ".glb")


def write_mesh(folder: Path, out: Path | None = None, *, resolution: float) -> Path:
    """The mesh of a result folder's map with cells of `resolution` [m], into `out` or the folder's mesh.ply; returns where.

    Raises ResultError where the map is missing, ConfigError for a resolution or a kind of file that cannot be.
    """
    if not 0 < resolution < np.inf:
        raise ConfigError(f"--resolution {resolution}, expected metres above 0, such as 0.01")
    path = out or folder / results.MESH
    if path.suffix not in MESH_FORMATS:
        raise ConfigError(f"--out {path}: meshes are written as {', '.join(MESH_FORMATS)}")
    saved = load_map(results.existing(folder, results.MAP))
    results.prepare(path.parent)
    with results.replacing(path) as part:
        saved.mesh(resolution).export(part)
    return path


def write_views(folder: Path, out: Path | None = None, *, frames: Sequence[int] = ()) -> list[Path]:
    """Colour (8 bit) and depth (16 bit, mm) that the map shows from `frames` (none: the keyframes), as PNG; returns the paths.

    Raises ResultError where map, trajectory or keyframes are missing, ConfigError for a frame that the trajectory does not have.
    """
    saved = load_map(results.existing(folder, results.MAP))
    trajectory = load_tum(results.existing(folder, results.TRAJECTORY))
    record = results.read_keyframes(folder)
    chosen = list(frames) or record.indices.tolist()
    for i in chosen:
        if not 0 <= i < len(trajectory):
            raise ConfigError(f"--frames {i}: the trajectory has frames 0 to {len(trajectory) - 1}")
    if not chosen:
        raise ResultError(f"{folder}: the run has no keyframes; choose frames with --frames")
    target = out or folder / "render"
    results.prepare(target)
    paths = []
    for i in chosen:
        colour, depth = saved.render(trajectory.poses[i], record.camera)
        pair = [target / f"{i:06d}-colour.png", target / f"{i:06d}-depth.png"]
        write_colour(pair[0], np.asarray(colour))
        write_depth(pair[1], np.asarray(depth))
        paths += pair
    return paths
