"""transforms.json as nerfstudio, instant-ngp and most radiance-field programs read it.

Its cameras look along -z with y up (OpenGL): T_wc times diag(1, -1, -1, 1). Its pixel centres lie at half integers, so the principal
point is half a pixel larger than here. Depth images are in millimetres, nerfstudio's own default. The world stays as it is.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from idfslam.errors import ResultError
from idfslam.export.images import COLOUR, DEPTH, PosedImage
from idfslam.geometry.camera import Camera
from idfslam.results import write_json

TRANSFORMS, POINTS = "transforms.json", "points.ply"
_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


def write_transforms(path: Path, images: Sequence[PosedImage], camera: Camera) -> None:
    """Images in `images/` and `depth/`, points in points.ply, all beside `path`."""
    frames = [
        {"file_path": f"{COLOUR}/{image.name}", "depth_file_path": f"{DEPTH}/{image.name}", "transform_matrix": image.T_wc @ _OPENGL}
        for image in images
    ]
    intrinsics = {"fl_x": camera.fx, "fl_y": camera.fy, "cx": camera.cx + 0.5, "cy": camera.cy + 0.5, "w": camera.width, "h": camera.height}
    distortion = dict.fromkeys(("k1", "k2", "p1", "p2"), 0.0)
    values = {"camera_model": "OPENCV", **intrinsics, **distortion, "depth_unit_scale_factor": 0.001, "ply_file_path": POINTS}
    write_json(path, {**values, "frames": frames})


def read_transforms(path: Path) -> tuple[NDArray[np.float64], Camera | None]:
    """T_wc (N, 4, 4) of its frames in the order of the file, and its camera where it has one for all frames; scale is taken as metres.

    Raises ResultError where the file is not of this kind.
    """
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
        poses = np.array([frame["transform_matrix"] for frame in values["frames"]], np.float64)
        if poses.ndim != 3 or poses.shape[1:] != (4, 4):
            raise ValueError(f"its matrices are {poses.shape}")
        return poses @ _OPENGL, _camera(values)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ResultError(f"{path}: not readable as transforms.json ({error}); expected frames with a 4 x 4 transform_matrix") from error


def _camera(values: dict[str, Any]) -> Camera | None:
    if not {"fl_x", "cx", "cy", "w", "h"} <= values.keys():
        return None
    fx = float(values["fl_x"])
    return Camera(int(values["w"]), int(values["h"]), fx, float(values.get("fl_y", fx)), values["cx"] - 0.5, values["cy"] - 0.5)
