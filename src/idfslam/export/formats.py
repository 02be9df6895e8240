"""The names of what an export can be: formats, sources of a texture, axes, and what happens to frames that were not measured."""

from typing import Literal

Format = Literal["tum", "kitti", "nerfstudio", "colmap", "ply", "obj", "glb", "points", "splats", "page", "masks", "grid", "blocks"]
Texture = Literal["images", "map"]  # the recording's images, or the map's colours
Up = Literal["z", "y", "camera"]  # the axis that points up; camera: the run's own world, x right, y down, z forward
Lost = Literal["keep", "drop"]  # frames whose pose was not measured
