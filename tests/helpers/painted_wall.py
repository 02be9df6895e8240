"""Images of a painted wall 2 m ahead, with a box before it, whose colours and depths can be worked out for any pose."""

import numpy as np
from numpy.typing import NDArray

from idfslam.frame import Frame
from idfslam.geometry.camera import Camera

CAMERA = Camera(160, 120, 140.0, 140.0, 79.5, 59.5)
WALL, BOX = 2.0, 1.5  # [m] depths of the wall, and of the front of the box
HALF = 0.25  # [m] half of the box's edge


def at(x: float, y: float = 0.0, turn: float = 0.0) -> NDArray[np.float64]:
    """T_wc (4, 4) of a camera shifted by x, y [m] along the wall, and turned about y [rad]."""
    T = np.eye(4)
    T[:3, :3] = [[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]]
    T[:2, 3] = x, y
    return T


def painted(index: int, T_wc: NDArray[np.float64], gain: float = 1.0) -> Frame:
    """The frame of a camera at T_wc. gain: of its exposure."""
    rays = CAMERA.rays(CAMERA.pixels()).numpy() @ T_wc[:3, :3].T
    on_box, on_wall = (T_wc[:3, 3] + rays * ((z - T_wc[2, 3]) / rays[..., 2:]) for z in (BOX, WALL))
    box = (np.abs(on_box[..., :2]) < HALF).all(-1)
    points = np.where(box[..., None], on_box, on_wall)
    x, y = points[..., 0], points[..., 1]
    waves = np.stack([np.sin(12 * x), np.cos(9 * y), np.sin(7 * (x + y))], -1)
    colour = (0.45 + 0.2 * waves + np.where(box, 0.1, 0.0)[..., None]) * gain
    depth = ((points - T_wc[:3, 3]) @ T_wc[:3, :3])[..., 2]
    return Frame(index, index / 30, colour.astype(np.float32), depth.astype(np.float32), CAMERA)
