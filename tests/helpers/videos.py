"""Small videos for the tests: frame i is of one colour, `shade(i)`."""

import json
import struct
from fractions import Fraction
from pathlib import Path
from typing import Any

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


def kinect_calibration(*, distortion: bool = False, t: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> dict[str, Any]:
    """As the device states it, in fractions of the whole sensors: focal lengths 0.5 and 0.625, centres in the middle."""
    k = [0.5, -0.3, 0.1, 0.7, -0.1, 0.02, 0.0, 0.0, 2e-4, -1e-4] if distortion else [0.0] * 10  # k1 to k6, 0, 0, p2, p1
    eye = [1, 0, 0, 0, 1, 0, 0, 0, 1]

    def camera(name: str, fx: float, fy: float, translation: tuple[float, ...]) -> dict[str, Any]:
        parameters = {"ModelParameters": [0.5, 0.5, fx, fy, *k], "ModelType": "CALIBRATION_LensDistortionModelBrownConrady"}
        location = f"CALIBRATION_CameraLocation{name}"
        return {"Intrinsics": parameters, "Location": location, "Rt": {"Rotation": eye, "Translation": list(translation)}}

    return {"CalibrationInformation": {"Cameras": [camera("D0", 0.5, 0.5, (0.0, 0.0, 0.0)), camera("PV0", 0.46875, 0.625, t)]}}


def write_kinect(
    path: Path,
    *,
    calibration: dict[str, Any] | None = None,
    frames: int = 3,
    size: tuple[int, int] = (1280, 720),
    depth: NDArray[np.uint16] | None = None,
    delay: float = 0.0,
) -> Path:
    """Tracks COLOR (MJPEG), DEPTH and IR (16-bit grey, as k4arecorder's b16g), calibration.json attached; depth 1 m + i mm."""
    depth = np.full((576, 640), 1000, np.uint16) if depth is None else depth
    height, width = depth.shape
    with av.open(str(path), "w", options={"allow_raw_vfw": "1"}) as container:
        colour = container.add_stream("mjpeg", rate=30)
        colour.width, colour.height, colour.pix_fmt, colour.bit_rate = *size, "yuvj420p", 20_000_000
        grey = [container.add_stream("rawvideo", rate=30) for _ in range(2)]
        for stream in grey:
            stream.width, stream.height, stream.pix_fmt = width, height, "gray16be"
        for stream, title in zip((colour, *grey), ("COLOR", "DEPTH", "IR"), strict=True):
            stream.metadata["title"] = title
        if calibration is not None:
            container.add_attachment("calibration.json", "application/octet-stream", json.dumps(calibration).encode())
        container.metadata["K4A_DEPTH_DELAY_NS"] = str(round(delay * 1e9))
        for i in range(frames):
            images = [(colour, colour_frame(i, size), "bgr24", 0.0)]
            images += [(grey[0], depth + np.uint16(i) * (depth > 0), "gray16be", delay), (grey[1], depth, "gray16be", delay)]
            for stream, image, form, late in images:
                frame = av.VideoFrame.from_ndarray(image, format=form)
                frame.pts, frame.time_base = round(i * 1000 / 30 + 1000 * late), Fraction(1, 1000)
                stream.codec_context.time_base = Fraction(1, 1000)
                container.mux(stream.encode(frame))
        for stream in (colour, *grey):
            container.mux(stream.encode())
    header = struct.pack("<IiiHH4s", 40, width, -height, 1, 16, bytes(4))  # ffmpeg leaves the format open that k4arecorder names
    path.write_bytes(path.read_bytes().replace(header, struct.pack("<IiiHH4s", 40, width, height, 1, 16, b"b16g")))
    return path
