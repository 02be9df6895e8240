"""A mesh as a small GLB file: normals, texture coordinates and colours of few bits (KHR_mesh_quantization), the texture as JPEG."""

import io
import json
import struct
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from idfslam import __version__
from idfslam.export.mesh_files import ATLAS_SAMPLER, MATTE, linear

_QUALITY = 85  # [1] of 100, of the texture. More: a larger file. Chosen by hand
_BYTE, _UNSIGNED_BYTE, _UNSIGNED_SHORT, _UNSIGNED_INT, _FLOAT = 5120, 5121, 5123, 5125, 5126  # component types: a fact of glTF 2.0
_JSON, _BINARY = 0x4E4F534A, 0x004E4942  # kinds of chunks: a fact of glTF 2.0


class _Buffer:
    """The binary part of a file, and the JSON that describes it."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []

    def view(self, data: bytes, **more: int) -> int:
        """Adds bytes. Returns the number of their view."""
        self.views.append({"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data), **more})
        self.data += data + b"\0" * (-len(data) % 4)
        return len(self.views) - 1

    def attribute(self, values: NDArray[Any], component: int, kind: str, *, normalised: bool = True, **more: Any) -> int:
        """Adds a value (V, n) for each vertex, padded to whole words. Returns the number of its accessor."""
        width = values.itemsize * values.shape[1]
        padded = np.zeros((len(values), -(-width // 4) * 4), np.uint8)
        padded[:, :width] = np.ascontiguousarray(values).view(np.uint8).reshape(len(values), width)
        view = self.view(padded.tobytes(), byteStride=padded.shape[1], target=34962)
        self.accessors.append({"bufferView": view, "componentType": component, "count": len(values), "type": kind, **more})
        if normalised:
            self.accessors[-1]["normalized"] = True
        return len(self.accessors) - 1


def compact_glb(mesh: trimesh.Trimesh) -> bytes:
    """The file of a mesh with vertex colours, sRGB, or with a texture; +y is up, as glTF demands."""
    buffer, visual = _Buffer(), mesh.visual
    points = np.asarray(mesh.vertices, "<f4")
    bounds = {"min": points.min(0).tolist(), "max": points.max(0).tolist()}
    normals = np.round(np.asarray(mesh.vertex_normals) * 127).astype(np.int8)
    attributes = {
        "POSITION": buffer.attribute(points, _FLOAT, "VEC3", normalised=False, **bounds),
        "NORMAL": buffer.attribute(normals, _BYTE, "VEC3"),
    }
    primitive: dict[str, Any] = {"attributes": attributes, "material": 0}
    surface: dict[str, Any] = dict(MATTE)
    tree: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": f"idf-slam {__version__}"},
        "extensionsUsed": ["KHR_mesh_quantization"], "extensionsRequired": ["KHR_mesh_quantization"],
        "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}], "meshes": [{"primitives": [primitive]}],
        "materials": [{"name": "surface", "pbrMetallicRoughness": surface}],
    }  # fmt: skip
    if isinstance(visual, trimesh.visual.TextureVisuals):
        uv = np.asarray(visual.uv, np.float64) * (1, -1) + (0, 1)  # glTF has the origin at the top
        attributes["TEXCOORD_0"] = buffer.attribute(np.round(uv * 65535).astype("<u2"), _UNSIGNED_SHORT, "VEC2")
        image: Any = visual.material
        jpeg = io.BytesIO()
        image.baseColorTexture.save(jpeg, "JPEG", quality=_QUALITY, subsampling=0)  # halved colours would mix neighbouring patches
        surface["baseColorTexture"] = {"index": 0}
        tree |= {"images": [{"bufferView": buffer.view(jpeg.getvalue()), "mimeType": "image/jpeg"}], "samplers": [ATLAS_SAMPLER]}
        tree["textures"] = [{"source": 0, "sampler": 0}]
    else:
        colours: Any = visual
        attributes["COLOR_0"] = buffer.attribute(linear(colours.vertex_colors), _UNSIGNED_BYTE, "VEC4")
    if not np.array_equal(np.ravel(mesh.faces), np.arange(mesh.faces.size)):
        view = buffer.view(np.asarray(mesh.faces, "<u4").tobytes(), target=34963)
        buffer.accessors.append({"bufferView": view, "componentType": _UNSIGNED_INT, "count": mesh.faces.size, "type": "SCALAR"})
        primitive["indices"] = len(buffer.accessors) - 1
    tree |= {"accessors": buffer.accessors, "bufferViews": buffer.views, "buffers": [{"byteLength": len(buffer.data)}]}
    text = json.dumps(tree, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), _JSON) + text + struct.pack("<II", len(buffer.data), _BINARY) + bytes(buffer.data)
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks
