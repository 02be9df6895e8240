"""Small videos for the tests: frame i is of one colour, `shade(i)`."""

from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from numpy.typing import NDArray


def shade(i: int) -> NDArray[np.float64]:
    """BGR of frame i."""
    return np.array([200 - 5 * i, 100, 20 + 7 * i], float)


def colour_frame(i: int, size: tuple[int, int]) -> NDArray[np.uint8]:
    return np.broadcast_to(shade(i).astype(np.uint8), (size[1], size[0], 3)).copy()


def write_video(path: Path, *, codec: str = "h264", frames: int = 3, size: tuple[int, int] = (64, 48)) -> Path:
    """30 frames a second, a key frame every 12."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=30, options={"crf": "12"} if codec == "h264" else {})
        stream.width, stream.height = size
        stream.pix_fmt = "yuvj420p" if codec == "mjpeg" else "yuv420p"
        stream.codec_context.gop_size = 12
        stream.bit_rate = 2_000_000
        for i in range(frames):
            frame = av.VideoFrame.from_ndarray(colour_frame(i, size), format="bgr24")
            frame.pts, frame.time_base = i, Fraction(1, 30)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path
