"""A COLMAP model as text: cameras.txt, images.txt, points3D.txt (https://colmap.github.io/format.html).

Poses are world-to-camera, with the camera axes of this package. COLMAP's pixel centres lie at half integers, so pixels and the principal
point are half a pixel larger than here. A point's track holds the images whose measured depth agrees with the point's.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from idfslam.export.images import PosedImage
from idfslam.export.point_cloud import PointCloud
from idfslam.storage import atomic_files

FILES = ("cameras.txt", "images.txt", "points3D.txt")
_DEPTH_TOLERANCE = 0.03  # a measured depth may differ from a point's by this share of it; larger: longer tracks, more wrong ones
_LEAST_TRACK = 2  # images that must see a point: COLMAP has no points of one image; larger: fewer, surer points


@dataclass(frozen=True, eq=False)
class _Sight:
    """The points that an image saw, and their pixels."""

    points: NDArray[np.int64]  # (M,) indices
    uv: NDArray[np.float64]  # (M, 2) [px], pixel centres at integers


def write_colmap(folder: Path, images: Sequence[PosedImage], cloud: PointCloud) -> None:
    """Writes the three files of the model, with every camera of the images. Points that fewer than two images saw are left out."""
    sights = [_sight(image, cloud.points) for image in images]
    cameras = {camera: i for i, camera in enumerate(dict.fromkeys(image.frame.camera for image in images), 1)}
    seen = sum((np.bincount(s.points, minlength=len(cloud.points)) for s in sights), np.zeros(len(cloud.points), np.int64))
    kept = seen >= min(_LEAST_TRACK, len(images))
    number = np.cumsum(kept)  # of a point that is kept, from 1
    tracks: list[list[str]] = [[] for _ in range(int(kept.sum()))]
    pinholes = [f"{i} PINHOLE {c.width} {c.height} {c.fx:.9g} {c.fy:.9g} {c.cx + 0.5:.9g} {c.cy + 0.5:.9g}\n" for c, i in cameras.items()]
    lines = []
    for i, (image, sight) in enumerate(zip(images, sights), 1):
        T_cw = np.linalg.inv(image.T_wc)
        x, y, z, w = Rotation.from_matrix(T_cw[:3, :3]).as_quat(canonical=True)
        numbers = " ".join(f"{value:.12g}" for value in (w, x, y, z, *T_cw[:3, 3]))
        own = kept[sight.points]
        ids, uv = number[sight.points[own]], sight.uv[own] + 0.5
        for place, point in enumerate(ids):
            tracks[point - 1].append(f"{i} {place}")
        sighted = " ".join(f"{u:.4f} {v:.4f} {p}" for (u, v), p in zip(uv, ids))
        lines.append(f"{i} {numbers} {cameras[image.frame.camera]} {image.name}\n{sighted}\n")
    rgb = np.round(cloud.colours[kept] * 255).astype(int)
    points = [
        f"{i} {x:.6f} {y:.6f} {z:.6f} {r} {g} {b} 0 {' '.join(track)}\n"
        for i, ((x, y, z), (r, g, b), track) in enumerate(zip(cloud.points[kept], rgb, tracks), 1)
    ]
    header = ("CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]", "IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME, then POINTS2D[]")
    heads = (*header, "POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[]")
    atomic_files.prepare(folder)
    for name, head, text in zip(FILES, heads, ("".join(pinholes), "".join(lines), "".join(points))):
        with atomic_files.replacing(folder / name) as part:
            part.write_text(f"# {head}\n{text}", encoding="utf-8")


def _sight(image: PosedImage, points: NDArray[np.float64]) -> _Sight:
    """The points (N, 3) [m] whose depth agrees with the image's."""
    camera = image.frame.camera
    T_cw = np.linalg.inv(image.T_wc)
    uv, z = camera.project(torch.from_numpy(points @ T_cw[:3, :3].T + T_cw[:3, 3]))
    inside = np.flatnonzero(camera.inside(uv, z).numpy())
    u, v, depth = uv[inside, 0].numpy(), uv[inside, 1].numpy(), z[inside].numpy()
    measured = image.frame.depth[np.round(v).astype(int), np.round(u).astype(int)]
    near = (measured > 0) & (np.abs(measured - depth) < _DEPTH_TOLERANCE * depth)
    return _Sight(inside[near], np.stack([u[near], v[near]], -1))
