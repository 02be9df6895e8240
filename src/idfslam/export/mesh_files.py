"""Writes meshes with vertex normals as PLY, OBJ (with MTL and PNG for a texture) and GLB.

Colours are sRGB with 8 bits in PLY, OBJ and textures. glTF's vertex colours are linear.
"""

from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from trimesh.exchange.gltf import export_glb
from trimesh.exchange.obj import export_obj
from trimesh.exchange.ply import export_ply

from idfslam import __version__
from idfslam.storage import atomic_files

MATTE = {"metallicFactor": 0.0, "roughnessFactor": 1.0}  # glTF takes a mesh that does not say so for metal
# Linear, without mip levels, whose texels would mix neighbours in the atlas that are none in the room; no repetition
ATLAS_SAMPLER = {"magFilter": 9729, "minFilter": 9729, "wrapS": 33071, "wrapT": 33071}
_MATTE_MTL = "newmtl {name}\nKa 0 0 0\nKd 1 1 1\nKs 0 0 0\nNs 0\nillum 1\n"  # the colours as they are: no highlights


def write_ply(path: Path, mesh: trimesh.Trimesh) -> list[Path]:
    """With vertex colours. PLY has no common convention for textures."""
    with atomic_files.replacing(path) as part:
        part.write_bytes(export_ply(mesh, vertex_normal=True))
    return [path]


def write_obj(path: Path, mesh: trimesh.Trimesh) -> list[Path]:
    """With vertex colours after the coordinates, or with a texture and a material (MTL) in the same folder. Returns all paths.

    Vertex colours have no material beside them: readers that find one take its colour instead.
    """
    material, visual = path.with_suffix(".mtl"), mesh.visual
    if isinstance(visual, trimesh.visual.TextureVisuals):
        simple: Any = visual.copy()
        simple.material = simple.material.to_simple()
        simple.material.name = path.stem
        mesh = trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_normals=mesh.vertex_normals, visual=simple, process=False)
    text, written = export_obj(mesh, include_normals=True, return_texture=True, mtl_name=material.name, header=f"idf-slam {__version__}")
    if material.name in written:
        written[material.name] = (_MATTE_MTL.format(name=path.stem) + f"map_Kd {path.stem}.png\n").encode()
    files = {path: text.encode(), **{path.parent / name: data for name, data in written.items()}}
    for place, data in files.items():
        with atomic_files.replacing(place) as part:
            part.write_bytes(data)
    return list(files)


def write_glb(path: Path, mesh: trimesh.Trimesh) -> list[Path]:
    """One file with a matte material and vertex colours, made linear, or a texture. The mesh is taken as it is: +y is up in glTF."""
    visual: Any = mesh.visual
    if not isinstance(visual, trimesh.visual.TextureVisuals):
        colours = linear(visual.vertex_colors)
        mesh = trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_normals=mesh.vertex_normals, vertex_colors=colours, process=False)
    with atomic_files.replacing(path) as part:
        part.write_bytes(export_glb(trimesh.Scene(mesh), include_normals=True, tree_postprocessor=_complete))
    return [path]


def _complete(tree: dict[str, Any]) -> None:
    """Adds to the JSON of a glTF file the program that wrote it, a sampler for a texture, and a material where there is none."""
    tree["asset"]["generator"] = f"idf-slam {__version__}"
    for texture in tree.get("textures", ()):
        tree["samplers"] = [ATLAS_SAMPLER]
        texture["sampler"] = 0
    if "materials" not in tree:
        tree["materials"] = [{"name": "surface", "pbrMetallicRoughness": MATTE, "doubleSided": True}]
        for mesh in tree["meshes"]:
            for primitive in mesh["primitives"]:
                primitive["material"] = 0


def linear(colours: np.ndarray) -> np.ndarray:
    """Vertex colours (N, 4) uint8 in sRGB as linear ones, of 8 bits again; alpha stays (IEC 61966-2-1)."""
    srgb = np.asarray(colours) / 255
    intensity = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    intensity[:, 3:] = srgb[:, 3:]
    return np.round(intensity * 255).astype(np.uint8)


def write_plain(path: Path, mesh: trimesh.Trimesh) -> list[Path]:
    """OFF or STL, by the ending: the shape alone."""
    with atomic_files.replacing(path) as part:
        mesh.export(part, file_type=path.suffix.lower()[1:])
    return [path]
