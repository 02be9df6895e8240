"""Reads GLB exports with pygltflib (`pip install pygltflib`) and prints what it has then: python pygltflib_.py FILE"""

import json
import sys
from importlib.metadata import version

import numpy as np
import pygltflib

tree = pygltflib.GLTF2().load(sys.argv[1])
primitive = tree.meshes[0].primitives[0]


def array(number: int) -> np.ndarray:
    accessor = tree.accessors[number]
    view = tree.bufferViews[accessor.bufferView]
    kind = {5121: np.uint8, 5125: np.uint32, 5126: np.float32}[accessor.componentType]
    columns = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}[accessor.type]
    start = (view.byteOffset or 0) + (accessor.byteOffset or 0)
    return np.frombuffer(tree.binary_blob(), kind, accessor.count * columns, start).reshape(-1, columns)


found = {"points": array(primitive.attributes.POSITION).tolist(), "normals": array(primitive.attributes.NORMAL).tolist()}
if primitive.attributes.COLOR_0 is not None:
    found["colours"] = (array(primitive.attributes.COLOR_0)[:, :3] / 255).tolist()
print("\n" + json.dumps({"program": f"pygltflib {version('pygltflib')}", **found}))
