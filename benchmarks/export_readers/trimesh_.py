"""Reads exports with trimesh and prints what it has then: python trimesh_.py FILE"""

import json
import sys
from typing import Any

import numpy as np
import trimesh

path = sys.argv[1]
options: dict = {"skip_materials": True} if path.endswith("glb") and "texture" not in path else {}
found = trimesh.load(path, process=False, **options)
mesh: Any = found.to_geometry() if isinstance(found, trimesh.Scene) else found
values = {"points": mesh.vertices}
if isinstance(mesh, trimesh.PointCloud):
    raw = mesh.metadata["_ply_raw"]["vertex"]["data"]
    values |= {"normals": np.stack([raw[name] for name in ("nx", "ny", "nz")], -1), "colours": mesh.colors[:, :3] / 255}
else:
    values["normals"] = mesh.vertex_normals
    if mesh.visual.kind == "vertex":
        values["colours"] = mesh.visual.vertex_colors[:, :3] / 255
arrays = {name: np.asarray(value).tolist() for name, value in values.items()}
print("\n" + json.dumps({"program": f"trimesh {trimesh.__version__}", **arrays}))
