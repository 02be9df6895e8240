"""The names of the export formats and of the sources of a texture."""

from typing import Literal

Format = Literal["tum", "kitti", "nerfstudio", "colmap", "ply", "obj", "glb", "points", "grid", "blocks"]
Texture = Literal["images", "map"]  # the recording's images, or the map's colours
