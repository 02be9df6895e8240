"""A coarse view: the depth and brightness of an image in cells, with what lies around each cell, for comparisons with other views."""

from dataclasses import asdict, dataclass, replace

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from idfslam.frame import Frame
from idfslam.geometry.camera import Camera
from idfslam.segmentation.constants import LEAST_AROUND, ROWS, SAMPLES
from idfslam.segmentation.plain_form import form
from idfslam.storage.state import State

Image = NDArray[np.float32]
_PIXEL = np.dtype("V12")  # of colour: three float32
_AROUND = np.ones((3, 3), np.uint8)  # a cell and its neighbours: the constants of `idfslam.segmentation.constants` are for these


@dataclass(frozen=True)
class CoarseView:
    """An image in h x w cells of `cell` x `cell` pixels. Cells without a reading have depth 0."""

    camera: Camera  # of the cells: its pixels are their middles
    depth: Image  # (h, w) [m] the median reading of each cell
    near: Image  # (h, w) [m] the nearest reading within 3 x 3 cells; infinite where too few have one
    far: Image  # (h, w) [m] the farthest one; 0 without any
    brightness: Image  # (h, w) mean in [0, 1]
    dark: Image  # (h, w) least brightness within 3 x 3 cells
    bright: Image  # (h, w) largest brightness within 3 x 3 cells

    def state(self) -> State:
        """All of it."""
        return {"camera": asdict(self.camera)} | {name: torch.from_numpy(getattr(self, name)) for name in _IMAGES}

    @classmethod
    def from_state(cls, state: State) -> "CoarseView":
        """The view that `state` was made from."""
        return cls(Camera(**state["camera"]), **{name: state[name].numpy() for name in _IMAGES})


_IMAGES = "depth", "near", "far", "brightness", "dark", "bright"


def cell_size(camera: Camera) -> int:
    """[px] of a cell's side."""
    return max(1, camera.height // ROWS)


def cells_camera(camera: Camera) -> Camera:
    """The camera whose pixels are the cells."""
    cell = cell_size(camera)
    width, height = -(-camera.width // cell), -(-camera.height // cell)
    return Camera(width, height, camera.fx / cell, camera.fy / cell, (camera.cx + 0.5) / cell - 0.5, (camera.cy + 0.5) / cell - 0.5)


def coarse_view(depth: Image, colour: Image, camera: Camera) -> CoarseView:
    """The coarse view of depth (H, W) [m] and colour (H, W, 3)."""
    from idfslam.segmentation.kernels import numba_segmentation

    small, cell = cells_camera(camera), cell_size(camera)
    parts = [np.empty((small.height, small.width), np.float32) for _ in range(6)]
    form(numba_segmentation.coarsen)(depth, colour, cell, max(1, cell // SAMPLES), *parts)
    middle, nearest, farthest, brightness, darkest, brightest = parts
    near, dark = (np.asarray(cv2.erode(image, _AROUND, borderType=cv2.BORDER_REPLICATE), np.float32) for image in (nearest, darkest))
    far, bright = (np.asarray(cv2.dilate(image, _AROUND, borderType=cv2.BORDER_REPLICATE), np.float32) for image in (farthest, brightest))
    known = cv2.boxFilter((middle > 0).astype(np.uint8), -1, _AROUND.shape, normalize=False, borderType=cv2.BORDER_CONSTANT)
    near[known < LEAST_AROUND] = np.inf
    return CoarseView(small, middle, near, far, brightness, dark, bright)


def thinned(frame: Frame) -> Frame:
    """The frame with those pixels alone that its coarse view reads: it is rectified in a fraction of the time.

    Returns the frame itself where its cells would become others.
    """
    c, step = frame.camera, max(1, cell_size(frame.camera) // SAMPLES)
    first = step // 2
    pixels = np.ascontiguousarray(frame.colour).view(_PIXEL)[..., 0], frame.depth  # one item a pixel is copied twice as fast as three
    colour, depth = (np.ascontiguousarray(image[first::step, first::step]) for image in pixels)
    small = c.every(step)
    same = cell_size(c) == step * cell_size(small) and _size(cells_camera(c)) == _size(cells_camera(small))
    return replace(frame, colour=colour[..., None].view(np.float32), depth=depth, camera=small) if same else frame


def _size(camera: Camera) -> tuple[int, int]:
    return camera.width, camera.height


def in_pixels(cells: NDArray[np.bool_], camera: Camera) -> NDArray[np.bool_]:
    """(H, W) a mask of cells (h, w) in the pixels of the image."""
    cell = cell_size(camera)
    return cells.repeat(cell, 0).repeat(cell, 1)[: camera.height, : camera.width]
