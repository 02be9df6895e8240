"""Reads exports with Open3D (`pip install open3d`) and prints what it has then: python open3d_.py FILE"""

import json
import sys

import numpy as np
import open3d

path = sys.argv[1]
if path.endswith("points.ply"):
    cloud = open3d.io.read_point_cloud(path)
    points, normals, colours = cloud.points, cloud.normals, cloud.colors
    found: dict = {}
else:
    mesh = open3d.io.read_triangle_mesh(path, enable_post_processing=False)
    points, normals, colours = mesh.vertices, mesh.vertex_normals, mesh.vertex_colors
    before = len(mesh.triangles)
    mesh.remove_degenerate_triangles()
    mesh.remove_duplicated_triangles()
    found = {"textures": len(mesh.textures), "bad_faces": before - len(mesh.triangles)}
values = {"points": points, "normals": normals, "colours": colours}
arrays = {name: np.asarray(value).tolist() for name, value in values.items() if len(value)}
print("\n" + json.dumps({"program": f"Open3D {open3d.__version__}", **arrays, **found}))
