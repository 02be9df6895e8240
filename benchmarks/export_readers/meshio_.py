"""Reads PLY exports with meshio and plyfile (`pip install meshio plyfile`) and prints what they have then: python meshio_.py FILE"""

import json
import sys
from importlib.metadata import version

import meshio
import numpy as np

mesh = meshio.read(sys.argv[1])
data = mesh.point_data
found = {"points": mesh.points.tolist()}
if "nx" in data:
    found["normals"] = np.stack([data[name] for name in ("nx", "ny", "nz")], -1).tolist()
if "red" in data:
    rgb = np.stack([data[name] for name in ("red", "green", "blue")], -1).astype(np.uint8)  # meshio takes PLY's uchar for signed
    found["colours"] = (rgb / 255).tolist()
print("\n" + json.dumps({"program": f"meshio {version('meshio')}", **found}))
