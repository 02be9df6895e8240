"""Reads a COLMAP model with COLMAP's own library (`pip install pycolmap`): python colmap.py FOLDER/sparse/0"""

import json
import sys

import numpy as np
import pycolmap

model = pycolmap.Reconstruction(sys.argv[1])
poses = {image.name: np.linalg.inv(np.vstack([image.cam_from_world().matrix(), [0, 0, 0, 1]])).tolist() for image in model.images.values()}
errors = []
for image in model.images.values():
    for seen in image.points2D:
        if seen.has_point3D():
            projected = image.project_point(model.points3D[seen.point3D_id].xyz)
            errors.append(float(np.linalg.norm(projected - seen.xy)))
points = [point.xyz.tolist() for point in model.points3D.values()]
print("\n" + json.dumps({"program": f"pycolmap {pycolmap.__version__}", "poses": poses, "points": points, "reprojection": max(errors)}))
