"""Writes transforms.json, which nerfstudio, instant-ngp and most radiance-field programs read.

Its cameras look along -z with y up (OpenGL): T_wc times diag(1, -1, -1, 1). Its pixel centres lie at half integers, so the principal
point is half a pixel larger than here. Depth images are in millimetres, nerfstudio's default. `status` of a frame says how its pose was
found; other programs pass over it.
"""

from collections.abc import Sequence
from pathlib import Path

from idfslam.export.images import COLOUR, DEPTH, PosedImage
from idfslam.geometry.camera import Camera
from idfslam.geometry.transforms_json import OPENGL
from idfslam.storage.atomic_files import write_json

TRANSFORMS, POINTS = "transforms.json", "points.ply"


def write_transforms(path: Path, images: Sequence[PosedImage]) -> None:
    """Writes transforms.json to `path`. The images lie in images/ and depth/, the points in points.ply, all in the same folder.

    The intrinsics stand once for all frames if the frames are of one camera, and otherwise in each frame.
    """
    cameras = {image.frame.camera for image in images}
    shared = _intrinsics(images[0].frame.camera) if len(cameras) == 1 else {}
    frames = [
        {
            "file_path": f"{COLOUR}/{image.name}",
            "depth_file_path": f"{DEPTH}/{image.name}",
            "transform_matrix": image.T_wc @ OPENGL,
            "status": image.status.value,
            **({} if shared else _intrinsics(image.frame.camera)),
        }
        for image in images
    ]
    values = {"camera_model": "OPENCV", **shared, "depth_unit_scale_factor": 0.001, "ply_file_path": POINTS}
    write_json(path, {**values, "frames": frames})


def _intrinsics(camera: Camera) -> dict[str, float]:
    size = {"w": camera.width, "h": camera.height}
    distortion = dict.fromkeys(("k1", "k2", "p1", "p2"), 0.0)
    return {"fl_x": camera.fx, "fl_y": camera.fy, "cx": camera.cx + 0.5, "cy": camera.cy + 0.5, **size, **distortion}
