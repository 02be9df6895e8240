"""One mesh of a saved map as a file: `idf-slam mesh`."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path

import trimesh

from idfslam.errors import ConfigError
from idfslam.export.axes import Axes
from idfslam.export.formats import Up
from idfslam.export.mesh_files import write_glb, write_obj, write_plain, write_ply
from idfslam.export.run_surface import check_resolution, mesh_of_map
from idfslam.export.surface import turned
from idfslam.runs import result_folder
from idfslam.runs.finished_run import FinishedRun
from idfslam.storage import atomic_files, output_folder

_WRITERS: dict[str, Callable[[Path, trimesh.Trimesh], list[Path]]] = {
    ".ply": write_ply, ".obj": write_obj, ".off": write_plain, ".stl": write_plain, ".glb": write_glb,
}  # fmt: skip


def write_mesh(
    folder: Path, out: Path | None = None, *, resolution: float, of_map: bool = False, up: Up | None = None, overwrite: bool = False
) -> list[Path]:
    """Writes the mesh of a result folder's map, in cells of `resolution` [m]. Returns the paths.

    of_map: in the colours that the map has learnt, instead of the archive's. out: None replaces the folder's mesh.ply, whose axes are
    always those of trajectory.txt. up: None is z for a file of one's own.
    Raises ResultError if the map is missing or a file would be replaced, ConfigError for invalid options.
    """
    path = out or folder / result_folder.MESH
    own = path.resolve() == (folder / result_folder.MESH).resolve()
    kind = path.suffix.lower()
    if kind not in _WRITERS:
        raise ConfigError(f"--out {path}: meshes are written as {', '.join(_WRITERS)}")
    if own and up not in (None, "camera"):
        raise ConfigError(f"--up {up}: {path} keeps the axes of {result_folder.TRAJECTORY}; name another file with --out")
    if not own and not overwrite:
        output_folder.refuse_existing(path)
    check_resolution(resolution)
    run = FinishedRun(folder)
    with _own_mesh(folder) if own else nullcontext():
        mesh = mesh_of_map(run, resolution, of_map=of_map)
        atomic_files.prepare(path.parent)
        axes = Axes.of(run, "camera" if own else up or "z")
        written = _WRITERS[kind](path, turned(mesh, axes.gltf.T_ew if kind == ".glb" else axes.T_ew))
    axes.warn_if_not_level()
    return written


@contextmanager
def _own_mesh(folder: Path) -> Iterator[None]:
    """The folder's mesh.ply can be written anew. Raises ResultError if it is not as the program wrote it, or if the folder is in use."""
    with output_folder.locked(folder):
        ledger = result_folder.ledger(folder)
        ledger.refuse_foreign([result_folder.MESH])
        yield
        ledger.record([result_folder.MESH])
