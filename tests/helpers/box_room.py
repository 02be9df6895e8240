"""A recording that tests write themselves: a camera turns slowly in a textured box, with exact depth and poses."""

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from idfslam.geometry.camera import Camera

BOX = np.array([1.5, 1.1, 1.8])  # half the sides of the box room [m]
BOX_FRAMES, BOX_WIDTH, BOX_HEIGHT, BOX_FOCAL = 14, 160, 120, 140.0
BOX_CAMERA = Camera(BOX_WIDTH, BOX_HEIGHT, BOX_FOCAL, BOX_FOCAL, (BOX_WIDTH - 1) / 2, (BOX_HEIGHT - 1) / 2)
OTHER_CAMERA = Camera(200, 150, 160.0, 165.0, 97.0, 76.0)  # another size and shape of pixels, its axis beside the middle


def box_poses(tilt: float = 0.0) -> NDArray[np.float64]:
    """(N, 4, 4) a slow turn with a shift in the box room: 1.5 degrees and 1.5 cm a frame.

    The camera looks down by `tilt` [degrees]. At 0 it sees two walls, along which depth leaves the height open; at 20 the floor as well.
    """
    poses = np.tile(np.eye(4), (BOX_FRAMES, 1, 1))
    angle = np.deg2rad(30 + 1.5 * np.arange(BOX_FRAMES))
    poses[:, 0, 0] = poses[:, 2, 2] = np.cos(angle)
    poses[:, 0, 2], poses[:, 2, 0] = np.sin(angle), -np.sin(angle)
    poses[:, 0, 3] = 0.015 * np.arange(BOX_FRAMES) - 0.1
    poses[:, 1, 3] = 0.03 * np.sin(0.4 * np.arange(BOX_FRAMES))
    poses[:, 2, 3] = 0.03 * np.cos(0.3 * np.arange(BOX_FRAMES))
    down = np.eye(4)
    down[1, 1] = down[2, 2] = np.cos(np.deg2rad(tilt))
    down[1, 2], down[2, 1] = np.sin(np.deg2rad(tilt)), -np.sin(np.deg2rad(tilt))
    return poses @ down


def box_view(T_wc: NDArray[np.float64], camera: Camera = BOX_CAMERA) -> tuple[NDArray[np.uint8], NDArray[np.uint16]]:
    """Colour (H, W, 3) BGR and depth (H, W) [mm] inside a textured box: along each axis a ray leaves at the wall it flies towards."""
    v, u = np.mgrid[: camera.height, : camera.width].astype(float)
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)], -1) @ T_wc[:3, :3].T
    rays[np.abs(rays) < 1e-9] = 1e-9
    t = (np.sign(rays) * BOX - T_wc[:3, 3]) / rays
    depth, wall = t.min(-1), t.argmin(-1)
    p = T_wc[:3, 3] + rays * depth[..., None]
    waves = 0.5 + 0.2 * np.sin(9 * p + wall[..., None]) + 0.2 * np.sin(23 * p[..., [1, 2, 0]] + 2 * wall[..., None])
    return (waves * 255).astype(np.uint8), np.round(depth * 1000).astype(np.uint16)


def write_box_recording(folder: Path, camera: Camera = BOX_CAMERA, *, tilt: float = 0.0) -> Path:
    """The box room as a plain folder with poses."""
    for name in ("rgb", "depth", "pose"):
        (folder / name).mkdir(parents=True)
    for i, T_wc in enumerate(box_poses(tilt)):
        colour, depth = box_view(T_wc, camera)
        cv2.imwrite(str(folder / "rgb" / f"{i:04d}.png"), colour)
        cv2.imwrite(str(folder / "depth" / f"{i:04d}.png"), depth)
        np.savetxt(folder / "pose" / f"{i:04d}.txt", T_wc)
    np.savetxt(folder / "intrinsics.txt", camera.matrix().numpy())
    return folder
