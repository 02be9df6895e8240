"""An image of the recording as the archive keeps it: colour as JPEG, depth in fewer rows as PNG of millimetres."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from idfslam.frame import Frame
from idfslam.geometry.depth_view import reduced_view

# [1] of 100, as JPEG has it. More: a larger archive. On RedKitchen's images 80 takes three quarters of the room of 90. Chosen by hand
_QUALITY = 90
DEPTH_ROWS = 120  # [px] least rows of a depth image. More: sharper outlines, and fewer images in the archive. Chosen by hand
_MILLIMETRES = 1000.0  # a metre in the units of the depth images: a fact of the format
_FARTHEST = np.iinfo(np.uint16).max
MOVING = -1.0  # [m] depth of a pixel that shows what moves; it is stored as 65535, which no camera reads


@dataclass(frozen=True, eq=False)
class EncodedView:
    """A frame's images, compressed."""

    index: int  # of the frame
    colour: bytes  # JPEG (H, W, 3)
    # PNG (h, w) uint16 [mm], 0: no reading, 65535: what moves. Pixels of the frame's depth image at regular distances (`reduced_view`)
    depth: bytes
    sharpness: float  # of colour, as `sensing.sharpness` measures it

    @property
    def size(self) -> int:
        """[bytes]"""
        return len(self.colour) + len(self.depth)


def encode(frame: Frame, sharpness: float, moving: NDArray[np.bool_] | None = None) -> EncodedView:
    """Compresses a frame's images. moving (H, W): pixels that show what moves, and are no part of views; None: none."""
    colour = cv2.cvtColor(cv2.convertScaleAbs(frame.colour, alpha=255), cv2.COLOR_RGB2BGR)
    jpeg = cv2.imencode(".jpg", colour, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1].tobytes()
    read = frame.depth if moving is None else np.where(moving, np.float32(np.inf), frame.depth)
    small = reduced_view(np.eye(4), read, frame.camera, DEPTH_ROWS).depth
    depth = np.clip(small * _MILLIMETRES + 0.5, 0, _FARTHEST).astype(np.uint16)
    return EncodedView(frame.index, jpeg, cv2.imencode(".png", depth)[1].tobytes(), sharpness)


def without(view: EncodedView, moving: NDArray[np.bool_]) -> EncodedView:
    """A view in which what moves is hidden, too: cells (h, w), of the pixels of its depth or coarser ones."""
    depth = decode_depth(view.depth)
    assert depth is not None
    hidden = cv2.resize(moving.astype(np.uint8), depth.shape[::-1], interpolation=cv2.INTER_NEAREST) > 0
    counts = np.where(hidden | (depth == MOVING), _FARTHEST, depth * _MILLIMETRES + 0.5).astype(np.uint16)
    return replace(view, depth=cv2.imencode(".png", counts)[1].tobytes())


def decode_colour(data: bytes) -> NDArray[np.uint8] | None:
    """RGB (H, W, 3); None if the data are no image."""
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR) if data else None
    return None if image is None else np.ascontiguousarray(image[..., ::-1])


def decode_depth(data: bytes) -> NDArray[np.float32] | None:
    """Depth (h, w) [m], 0: no reading, MOVING: of what moves; None if the data are no depth image."""
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) if data else None
    if image is None or image.dtype != np.uint16 or image.ndim != 2:
        return None
    return np.where(image == _FARTHEST, np.float32(MOVING), image / np.float32(_MILLIMETRES)).astype(np.float32)
