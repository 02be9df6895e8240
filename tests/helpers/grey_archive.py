"""An archive of two grey images of 16 x 12 pixels."""

import numpy as np

from idfslam.frame import Frame
from idfslam.geometry.camera import Camera
from idfslam.views.encoded_view import encode
from idfslam.views.image_archive import ImageArchive, archive_of


def grey_archive() -> ImageArchive:
    """Frames 0 and 1, which are the same."""
    camera = Camera(16, 12, 15.0, 15.0, 7.5, 5.5)
    colour, depth = np.full((12, 16, 3), 0.5, np.float32), np.ones((12, 16), np.float32)
    return archive_of([encode(Frame(i, i / 10, colour, depth, camera), 0.5) for i in range(2)], camera, np.stack([np.eye(4)] * 2))
