"""Writes meshes as PLY, OBJ (with MTL and PNG for a texture) and GLB."""

from pathlib import Path

import numpy as np
import trimesh
from trimesh.exchange.obj import export_obj

from idfslam.storage import atomic_files

_UPRIGHT = np.diag([1.0, -1.0, -1.0, 1.0])  # glTF's y points up, the first camera's down


def write_ply(path: Path, mesh: trimesh.Trimesh) -> list[Path]:
    """With vertex colours. PLY has no common convention for textures."""
    with atomic_files.replacing(path) as part:
        mesh.export(part, file_type="ply")
    return [path]


def write_obj(path: Path, mesh: trimesh.Trimesh) -> list[Path]:
    """With vertex colours after the coordinates, or with a material and its image in the same folder. Returns all paths."""
    material = path.with_suffix(".mtl")
    if isinstance(mesh.visual, trimesh.visual.TextureVisuals):
        visual = mesh.visual.copy()
        visual.material = visual.material.to_simple()
        visual.material.name = path.stem
        mesh = trimesh.Trimesh(mesh.vertices, mesh.faces, visual=visual, process=False)
    text, textures = export_obj(mesh, return_texture=True, mtl_name=material.name)
    written = {path: text.encode(), **{path.parent / name: data for name, data in textures.items()}}
    for place, data in written.items():
        with atomic_files.replacing(place) as part:
            part.write_bytes(data)
    return list(written)


def write_glb(path: Path, mesh: trimesh.Trimesh) -> list[Path]:
    """One file with colours or texture. Its node rotates the world by half a turn about x, since +y is up in glTF."""
    scene = trimesh.Scene()
    scene.add_geometry(mesh, transform=_UPRIGHT)
    with atomic_files.replacing(path) as part:
        scene.export(part, file_type="glb")
    return [path]
