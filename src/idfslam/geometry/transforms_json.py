"""Reads poses and camera from a transforms.json of nerfstudio, instant-ngp and most other radiance-field programs.

Its cameras look along -z with y up (OpenGL), and its pixel centres are at half integers.
"""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from idfslam.errors import ResultError
from idfslam.geometry.camera import Camera
from idfslam.storage.json_file import read_json

OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])  # T_wc @ OPENGL is the pose of the same camera with OpenGL's axes, and the other way round


def read_transforms(path: Path) -> tuple[NDArray[np.float64], Camera | None]:
    """T_wc (N, 4, 4) of the frames in the order of the file, and the camera if all frames share one; units are assumed to be metres.

    Raises ResultError if the file has another form.
    """
    try:
        values = read_json(path, error=ResultError, expected="frames with a 4 x 4 transform_matrix")
        poses = np.array([frame["transform_matrix"] for frame in values["frames"]], np.float64)
        if poses.ndim != 3 or poses.shape[1:] != (4, 4):
            raise ValueError(f"its matrices are {poses.shape}")
        return poses @ OPENGL, _camera(values)
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
        raise ResultError(f"{path}: not readable as transforms.json ({error}); expected frames with a 4 x 4 transform_matrix") from error


def _camera(values: dict[str, Any]) -> Camera | None:
    if not {"fl_x", "cx", "cy", "w", "h"} <= values.keys():
        return None
    fx = float(values["fl_x"])
    return Camera(int(values["w"]), int(values["h"]), fx, float(values.get("fl_y", fx)), values["cx"] - 0.5, values["cy"] - 0.5)
