"""Writes video files: H.264, which browsers play, if PyAV is installed; otherwise MPEG-4 by OpenCV."""

import logging
from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from idfslam.errors import ConfigError, ResultError, pip_install

log = logging.getLogger(__name__)

Image = NDArray[np.uint8]  # (H, W, 3) RGB
_QUALITY = "20"  # constant rate factor of H.264; larger: smaller files; 18 looks like the original, at 28 losses are visible


def write_video(path: Path, images: Iterable[Image], *, fps: float) -> int:
    """Writes the images as .mp4, cropped to an even size. Returns their number.

    Raises ConfigError for another file ending, ResultError if OpenCV cannot write videos.
    """
    if path.suffix != ".mp4":
        raise ConfigError(f"{path}: videos are written as .mp4")
    even = (np.ascontiguousarray(image[: image.shape[0] // 2 * 2, : image.shape[1] // 2 * 2]) for image in images)
    try:
        import av  # noqa: F401
    except ImportError:
        log.warning(f"PyAV is not installed: the video is MPEG-4, which browsers do not play; for H.264: {pip_install('av')}")
        return _write_opencv(path, even, fps)
    return _write_h264(path, even, fps)


def _write_h264(path: Path, images: Iterable[Image], fps: float) -> int:
    import av

    count = 0
    with av.open(str(path), "w", format="mp4", options={"movflags": "faststart"}) as container:
        stream = container.add_stream("libx264", rate=Fraction(fps).limit_denominator(1000))
        stream.pix_fmt, stream.options = "yuv420p", {"crf": _QUALITY}
        for image in images:
            if not count:
                stream.height, stream.width = image.shape[:2]
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
            count += 1
        container.mux(stream.encode())
    return count


def _write_opencv(path: Path, images: Iterable[Image], fps: float) -> int:
    writer, count = None, 0
    try:
        for image in images:
            if writer is None:
                writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), fps, (image.shape[1], image.shape[0]))
                if not writer.isOpened():
                    raise ResultError(f"{path}: OpenCV cannot write videos here; {pip_install('av')}")
            writer.write(cv2.cvtColor(image, cv2.COLOR_RGB2BGR))
            count += 1
    finally:
        if writer is not None:
            writer.release()
    return count
