"""A COLMAP model as text: cameras.txt, images.txt, points3D.txt (https://colmap.github.io/format.html).

Poses are world-to-camera; camera axes are this package's. Pixel centres lie at half integers, so pixels and the principal point are half
a pixel larger than here. A point belongs to each image that measured a depth near its own.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from idfslam.export.images import PosedImage
from idfslam.export.point_cloud import PointCloud
from idfslam.geometry.camera import Camera
from idfslam.storage import atomic_files

FILES = ("cameras.txt", "images.txt", "points3D.txt")
_NEAR = 0.03  # share of the depth by which a measured depth may differ from a point's own
_LEAST_TRACK = 2  # images that see a point: COLMAP knows no points of one image


@dataclass(frozen=True, eq=False)
class _Sight:
    """The points that an image saw, and where."""

    points: NDArray[np.int64]  # (M,) indices
    uv: NDArray[np.float64]  # (M, 2) [px], pixel centres at integers


def write_colmap(folder: Path, images: Sequence[PosedImage], camera: Camera, cloud: PointCloud) -> None:
    """The three files of the model; points that fewer than two images saw are left out."""
    sights = [_sight(image, camera, cloud.points) for image in images]
    seen = sum((np.bincount(s.points, minlength=len(cloud.points)) for s in sights), np.zeros(len(cloud.points), np.int64))
    kept = seen >= min(_LEAST_TRACK, len(images))
    number = np.cumsum(kept)  # of a point that is kept, from 1
    tracks: list[list[str]] = [[] for _ in range(int(kept.sum()))]
    c = camera
    cameras = f"1 PINHOLE {c.width} {c.height} {c.fx:.9g} {c.fy:.9g} {c.cx + 0.5:.9g} {c.cy + 0.5:.9g}\n"
    lines = []
    for i, (image, sight) in enumerate(zip(images, sights), 1):
        T_cw = np.linalg.inv(image.T_wc)
        x, y, z, w = Rotation.from_matrix(T_cw[:3, :3]).as_quat(canonical=True)
        numbers = " ".join(f"{value:.12g}" for value in (w, x, y, z, *T_cw[:3, 3]))
        own = kept[sight.points]
        ids, uv = number[sight.points[own]], sight.uv[own] + 0.5
        for place, point in enumerate(ids):
            tracks[point - 1].append(f"{i} {place}")
        lines.append(f"{i} {numbers} 1 {image.name}\n" + " ".join(f"{u:.4f} {v:.4f} {p}" for (u, v), p in zip(uv, ids)) + "\n")
    rgb = np.round(cloud.colours[kept] * 255).astype(int)
    points = [
        f"{i} {x:.6f} {y:.6f} {z:.6f} {r} {g} {b} 0 {' '.join(track)}\n"
        for i, ((x, y, z), (r, g, b), track) in enumerate(zip(cloud.points[kept], rgb, tracks), 1)
    ]
    header = ("CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]", "IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME, then POINTS2D[]")
    heads = (*header, "POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[]")
    atomic_files.prepare(folder)
    for name, head, text in zip(FILES, heads, (cameras, "".join(lines), "".join(points))):
        with atomic_files.replacing(folder / name) as part:
            part.write_text(f"# {head}\n{text}", encoding="utf-8")


def _sight(image: PosedImage, camera: Camera, points: NDArray[np.float64]) -> _Sight:
    """Which of points (N, 3) [m] the image's depth agrees with."""
    T_cw = np.linalg.inv(image.T_wc)
    x, y, z = (points @ T_cw[:3, :3].T + T_cw[:3, 3]).T
    safe = np.where(z > 0, z, 1.0)
    u, v = x / safe * camera.fx + camera.cx, y / safe * camera.fy + camera.cy
    inside = np.flatnonzero((z > 0) & (u >= -0.5) & (v >= -0.5) & (u < camera.width - 0.5) & (v < camera.height - 0.5))
    measured = image.frame.depth[np.round(v[inside]).astype(int), np.round(u[inside]).astype(int)]
    near = inside[(measured > 0) & (np.abs(measured - z[inside]) < _NEAR * z[inside])]
    return _Sight(near, np.stack([u[near], v[near]], -1))
