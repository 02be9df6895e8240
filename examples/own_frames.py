"""Frames from anywhere: numpy arrays of colour and depth into Slam, here of a box-shaped room computed on the spot.

Usage: python examples/own_frames.py [FRAMES]
"""

import sys

import numpy as np

from idfslam import Camera, Frame, Slam

CAMERA = Camera(width=160, height=120, fx=140.0, fy=140.0, cx=79.5, cy=59.5)  # pixel centres at integers
HALF = np.array([0.6, 0.45, 1.5])  # half the sides of the room [m]: five walls in view, so that every direction is held


def grab(i: int) -> tuple[np.ndarray, np.ndarray]:
    """In place of your camera: colour (H, W, 3) uint8 RGB and depth (H, W) uint16 [mm], from a camera moving 1 cm a frame to the right."""
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    rays = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones(u.shape)], -1)
    position = np.array([0.01 * i, 0, 0])
    depth = ((np.sign(rays) * HALF - position) / np.where(rays == 0, 1e-9, rays)).min(-1)
    points = position + rays * depth[..., None]
    colour = 0.5 + 0.25 * np.sin(9 * points) + 0.2 * np.sin(23 * points[..., [1, 2, 0]])
    return (colour * 255).astype(np.uint8), (depth * 1000).astype(np.uint16)


slam = Slam()
for i in range(int(sys.argv[1]) if len(sys.argv) > 1 else 30):
    colour, depth = grab(i)
    frame = Frame.from_images(colour, depth, CAMERA, index=i, timestamp=i / 30, depth_scale=1000)  # 1000 units of depth are a metre
    result = slam.process(frame)
    print(f"frame {i}: {result.status.value}, x = {result.T_wc[0, 3]:.3f} m, expected {0.01 * i:.3f} m")
slam.finish()
print(f"{len(slam.graph.keyframes)} keyframes")
