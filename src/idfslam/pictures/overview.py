"""A run in one picture: the room from outside with the camera's path, and beside it one recorded view and the map's own view from there."""

from pathlib import Path

import cv2
import numpy as np
import trimesh
from numpy.typing import NDArray

from idfslam.geometry.camera import Camera
from idfslam.geometry.even_spacing import evenly_spread
from idfslam.geometry.level import up_direction
from idfslam.pictures.direction import best_direction
from idfslam.pictures.image_files import RenderedView, to_bytes
from idfslam.pictures.mesh_renderer import Lighting, Picture, pose_outside
from idfslam.pictures.scraps import without_scraps

Floats = NDArray[np.float64]
Image = NDArray[np.uint8]  # (H, W, 3) RGB

_OUTSIDE = Camera(960, 720, 1200.0, 1200.0, 479.5, 359.5)
_INSIDE = (480, 360)  # [px] width and height of each view from inside: two of them are as high as the room
_FRUSTA = 24  # at most; more: a busier picture
_FRUSTUM = 0.22  # [m] depth of a frustum
_HIDDEN = 0.05  # [m] a line is hidden where it lies so far behind the surface; larger: lines shine through thin things
_SAMPLE = 0.01  # [m] between the points of a line
_PATH, _KEYFRAME, _INK = (31, 92, 219), (214, 84, 20), (20, 20, 20)  # RGB
_UNSEEN = (0.93, 0.93, 0.93)  # RGB of the background, and of what no camera saw
_SHIFT = 4  # bits of a pixel's fraction in OpenCV's coordinates


def draw_overview(
    path: Path, mesh: trimesh.Trimesh, poses: Floats, keyframes: NDArray[np.int64], camera: Camera, view: RenderedView
) -> None:
    """Writes the picture as PNG: ceiling and near walls, which show their backs, are left out.

    poses (N, 4, 4) camera-to-world of all frames, keyframes (K,) their indices, camera that of the frames, view the frame shown beside it.
    Raises ResultError for a mesh without faces.
    """
    mesh, up = without_scraps(mesh), up_direction(mesh, poses)
    picture = Picture(mesh, inside=poses[:, :3, 3])
    T_wo = pose_outside(mesh, up, best_direction(mesh, poses[:, :3, 3], up), _OUTSIDE)
    shown = picture.draw(T_wo, _OUTSIDE, Lighting(background=_UNSEEN))
    depth = picture.depth(T_wo, _OUTSIDE)
    for T_wk in poses[keyframes[evenly_spread(len(keyframes), _FRUSTA)]]:
        for line in frustum(T_wk, camera):
            _draw_line(shown, depth, T_wo, line, _KEYFRAME, 1)
    _draw_line(shown, depth, T_wo, poses[:, :3, 3], _PATH, 2)
    inside = [_labelled(view.colour, f"recorded, frame {view.index}"), _labelled(view.rendered_colour, "the map, rendered from there")]
    image = np.concatenate([shown, np.concatenate(inside)], axis=1)
    path.write_bytes(cv2.imencode(".png", cv2.cvtColor(image, cv2.COLOR_RGB2BGR))[1].tobytes())


def frustum(T_wk: Floats, camera: Camera) -> list[Floats]:
    """The edges of a camera's pyramid as lines (M, 3) [m]: the image's border, and four lines from the centre to its corners."""
    u, v = np.array([0, camera.width - 1, camera.width - 1, 0]), np.array([0, 0, camera.height - 1, camera.height - 1])
    local = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(4)], -1) * _FRUSTUM
    corners, centre = local @ T_wk[:3, :3].T + T_wk[:3, 3], T_wk[:3, 3]
    return [corners[[0, 1, 2, 3, 0]], *(np.stack([centre, corner]) for corner in corners)]


def _draw_line(image: Image, depth: NDArray[np.floating], T_wo: Floats, line: Floats, colour: tuple[int, int, int], width: int) -> None:
    """Draws a line (M, 3) [m] into the image where no surface hides it."""
    points = _resampled(line)
    x, y, z = ((points - T_wo[:3, 3]) @ T_wo[:3, :3]).T
    u, v = _OUTSIDE.fx * x / z + _OUTSIDE.cx, _OUTSIDE.fy * y / z + _OUTSIDE.cy
    column, row = (np.clip(values.round().astype(int), 0, size - 1) for values, size in ((u, _OUTSIDE.width), (v, _OUTSIDE.height)))
    surface = depth[row, column]
    visible = (surface == 0) | (z < surface + _HIDDEN)
    pixels = (np.stack([u, v], -1) * 2**_SHIFT).round().astype(np.int32)
    for i in np.nonzero(visible[:-1] & visible[1:])[0]:
        cv2.line(image, pixels[i].tolist(), pixels[i + 1].tolist(), colour, width, cv2.LINE_AA, _SHIFT)


def _resampled(line: Floats) -> Floats:
    """The line with points so near each other that hidden and visible parts are told apart."""
    lengths = np.linalg.norm(np.diff(line, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(lengths)])
    places = np.linspace(0, along[-1], max(2, int(np.ceil(along[-1] / _SAMPLE)) + 1))
    return np.stack([np.interp(places, along, line[:, axis]) for axis in range(3)], -1)


def _labelled(colour: NDArray[np.float32], text: str) -> Image:
    """The picture at the size of a view from inside, with a caption in its lower left corner."""
    image = cv2.resize(to_bytes(colour), _INSIDE, interpolation=cv2.INTER_AREA)
    font, size, low = cv2.FONT_HERSHEY_SIMPLEX, 0.55, _INSIDE[1]
    (width, height), below = cv2.getTextSize(text, font, size, 1)
    image[low - height - below - 8 :, : width + 16] = _INK
    cv2.putText(image, text, (8, low - below - 4), font, size, (255, 255, 255), 1, cv2.LINE_AA)
    return np.asarray(image)
