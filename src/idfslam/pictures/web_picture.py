"""A picture as part of a page: its bytes, compressed, in the place of the address of a file (RFC 2397)."""

import base64
import io

import numpy as np
from numpy.typing import NDArray
from PIL import Image


def data_address(pixels: NDArray[np.uint8], quality: int, *, largest: int | None = None) -> str:
    """The address of an image (H, W, 3) or (H, W, 4) as WebP. quality: 0 to 100. largest: its longer side [px] at most; None: as it is."""
    image, file = Image.fromarray(pixels), io.BytesIO()
    if largest is not None:
        image.thumbnail((largest, largest))
    image.save(file, "WEBP", quality=quality)
    return f"data:image/webp;base64,{base64.b64encode(file.getvalue()).decode()}"
