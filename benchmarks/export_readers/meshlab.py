"""Reads exports with MeshLab's library (`pip install pymeshlab`) and prints what it has then: python meshlab.py FILE"""

import json
import sys
from importlib.metadata import version

import pymeshlab

meshes = pymeshlab.MeshSet()
meshes.load_new_mesh(sys.argv[1])
mesh = meshes.current_mesh()
found = {"points": mesh.transformed_vertex_matrix().tolist(), "normals": mesh.vertex_normal_matrix().tolist()}
if mesh.has_vertex_color():
    found["colours"] = mesh.vertex_color_matrix()[:, :3].tolist()
print("\n" + json.dumps({"program": f"MeshLab (pymeshlab {version('pymeshlab')})", **found}))
