"""Reads, validates and converts colour and depth images. Whatever is wrong with one image is a FrameError of one line."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from idfslam.datasets.images import array_files
from idfslam.datasets.images.file_numbers import counting_numbers
from idfslam.datasets.images.image_header import claimed_size, is_whole_png
from idfslam.errors import FrameError, RecordingError
from idfslam.frame_images import SATURATED
from idfslam.geometry.camera import Camera

Depth = NDArray[np.uint16] | NDArray[np.float32]
"""A depth image (H, W) as stored. uint16: 0 and 65535 mean no reading; float32: 0, negative and non-finite values mean no reading."""

FilePair = tuple[Path, Path | None]
"""The files of colour and of depth; None: a frame without a depth image."""

SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".bmp", ".ppm", ".pgm", ".tif", ".tiff", ".webp"})
DEPTH_SUFFIXES = frozenset({*SUFFIXES, ".pfm", ".raw", ".bin", *array_files.READERS}) - {".jpg", ".jpeg", ".webp"}
_RAW = frozenset({".raw", ".bin"})  # numbers without a header
_INTEGERS = frozenset({".png", ".bmp", ".ppm", ".pgm"})  # kinds of files that hold nothing else
_PNG = b"\x89PNG\r\n\x1a\n"
_JPEG = b"\xff\xd8"


@dataclass(frozen=True)
class ImageFiles:
    """Reads images from files. Called with i, returns colour (H, W, 3) uint8 BGR and depth (H, W) of pair i; None without depth."""

    pairs: Sequence[FilePair]

    def __call__(self, i: int) -> tuple[NDArray[np.uint8], Depth | None]:
        colour, depth = self.pairs[i]
        if depth is None:
            return self.colour(i), None
        if depth.suffix.lower() in _RAW:
            image = decode_colour(_read(colour), str(colour))
            return image, decode_raw(_read(depth), image.shape[:2], str(depth))
        raw = read_depth(depth)  # first, because it detects swapped folders
        return self.colour(i), raw

    def colour(self, i: int) -> NDArray[np.uint8]:
        """(H, W, 3) BGR of pair i."""
        path = self.pairs[i][0]
        return decode_colour(_read(path), str(path))


def read_depth(path: Path) -> Depth:
    """Reads a depth image (H, W) as stored; raises FrameError."""
    if path.suffix.lower() in array_files.READERS:
        return as_depth(array_files.read_array(path), str(path))
    return decode_depth(_read(path), str(path))


def read_values(path: Path) -> NDArray[Any]:
    """Reads an image of any kind as stored; raises FrameError."""
    return _decode(_read(path), cv2.IMREAD_UNCHANGED, str(path))


def holds_floats(colour: Path, depth: Path) -> bool:
    """Whether a depth image holds floating-point numbers, which are metres where nobody states another scale; False if it is unreadable."""
    if depth.suffix.lower() in _INTEGERS:
        return False
    try:
        raw = ImageFiles([(colour, depth)])(0)[1]
        return raw is not None and raw.dtype == np.float32
    except FrameError:
        return False


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise FrameError(f"{path}: {error.strerror}, expected an image") from error


def decode_colour(data: bytes, source: str) -> NDArray[np.uint8]:
    """Decodes a colour image: (H, W, 3) uint8 BGR, not rotated by EXIF, as depth is not; `source` names the image in messages."""
    if data.startswith(_PNG) and data[24:26] == b"\x10\x00":  # bit depth 16, grey
        raise FrameError(f"{source}: a 16-bit grey image, expected colour: are the colour and depth images swapped?")
    image = _decode(data, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION, source)
    return np.asarray(image, np.uint8)


def decode_depth(data: bytes, source: str) -> Depth:
    """Decodes a depth image: (H, W) as stored; `source` names the image in messages."""
    return as_depth(_decode(data, cv2.IMREAD_UNCHANGED, source), source)


def decode_raw(data: bytes, size: tuple[int, ...], source: str) -> Depth:
    """Depth (H, W) without a header, uint16 or float32, with the proportions (height, width) of its colour image."""
    for dtype in (np.dtype("<u2"), np.dtype("<f4")):  # one has twice the other's pixels, so at most one of the sizes is whole
        pixels = len(data) / dtype.itemsize
        height, width = (round((pixels * a / b) ** 0.5) for a, b in (size, size[::-1]))
        if 0 < height * width == pixels and height * size[1] == width * size[0]:
            return as_depth(np.frombuffer(data, dtype).reshape(height, width), source)
    found = f"{len(data)} bytes"
    raise FrameError(f"{source}: {found}, expected uint16 or float32 depth with the proportions of the {size[1]}x{size[0]} colour image")


def as_depth(image: NDArray[Any], source: str) -> Depth:
    """Depth (H, W) as stored, from an array of any type; raises FrameError if it is no depth image."""
    if image.ndim == 3 and 1 in (image.shape[0], image.shape[2]):
        image = image[0] if image.shape[0] == 1 else image[..., 0]
    if image.ndim == 3 and image.dtype == np.uint8:
        raise FrameError(f"{source}: a colour image, expected 16-bit depth: are the colour and depth images swapped?")
    if not image.size:
        raise FrameError(f"{source}: an array of {image.shape} without a pixel, expected depth: copy the recording again")
    if image.ndim != 2 or image.dtype.kind not in "fiu" or image.dtype.itemsize == 1:
        channels = image.shape[2] if image.ndim == 3 else 1
        found = f"{8 * image.dtype.itemsize}-bit, {channels} channel(s)" if image.ndim in (2, 3) else f"{image.ndim} dimensions"
        raise FrameError(f"{source}: depth of {found}, expected one channel of 16 bits: export the depth as 16-bit PNG")
    if image.dtype.kind == "f":
        with np.errstate(over="ignore"):  # becomes infinite: no reading
            return np.asarray(image, np.float32)
    if image.dtype == np.uint16:
        return np.ascontiguousarray(image)
    return np.where((image > 0) & (image < SATURATED), image, 0).astype(np.uint16)


def _decode(data: bytes, flags: int, source: str) -> NDArray[np.generic]:
    width, height = claimed_size(data)
    absurd = width * height > array_files.MOST_VALUES
    # OpenCV fills the missing rest of a truncated file and reports success. Chunks and the end marker tell whether a file is complete
    cut = (data.startswith(_PNG) and not is_whole_png(data)) or (data.startswith(_JPEG) and b"\xff\xd9" not in data[-1024:])
    try:
        image = None if cut or absurd or not data else cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error:  # a damaged header with an absurd size
        image = None
    if image is None:
        what = "empty" if not data else "cut off" if cut else f"{width}x{height} pixels" if absurd else "not a readable image"
        raise FrameError(f"{source}: {what} ({len(data)} bytes): copy the recording again or leave the frame out")
    return np.asarray(image)


def rgb(bgr: NDArray[np.uint8]) -> NDArray[np.float32]:
    """(H, W, 3) uint8 BGR -> float32 RGB in [0, 1]."""
    unit: NDArray[np.float32] = np.multiply(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), np.float32(1 / 255), dtype=np.float32)
    return unit


def metres(raw: Depth, scale: float) -> NDArray[np.float32]:
    """(H, W) as stored -> float32 [m]; 0 where there is no reading."""
    depth: NDArray[np.float32] = np.multiply(raw, np.float32(1 / scale), dtype=np.float32)
    depth[raw == SATURATED if raw.dtype == np.uint16 else ~readings(raw)] = 0  # a count of 0 is 0 m
    return depth


def readings(raw: Depth) -> NDArray[np.bool_]:
    """(H, W) whether each pixel of a depth image as stored has a reading."""
    return (raw != 0) & (raw != SATURATED) if raw.dtype == np.uint16 else np.isfinite(raw) & (raw > 0) & (raw != SATURATED)


def has_readings(raw: Depth) -> bool:
    """Whether any pixel of a depth image (H, W) as stored has a reading."""
    return bool(readings(raw).any())


class Undistortion:
    """Resamples images to the pinhole camera without distortion: colour linearly, depth by the nearest pixel, which mixes no surfaces."""

    def __init__(self, camera: Camera, distortion: tuple[float, ...]) -> None:
        K, size = camera.matrix().numpy(), (camera.width, camera.height)
        x, y = cv2.initUndistortRectifyMap(K, np.array(distortion), None, K, size, cv2.CV_32FC1)
        self._linear = cv2.convertMaps(x, y, cv2.CV_16SC2)
        self._nearest = (x, y)

    def colour(self, bgr: NDArray[np.uint8]) -> NDArray[np.uint8]:
        return np.asarray(cv2.remap(bgr, *self._linear, cv2.INTER_LINEAR), np.uint8)

    def depth(self, raw: Depth) -> Depth:
        return cast(Depth, cv2.remap(raw, *self._nearest, cv2.INTER_NEAREST))


def numbered(folder: Path, pattern: str = "*", *, suffixes: frozenset[str] = SUFFIXES) -> dict[float, Path]:
    """The files of a folder with these suffixes (default: images) by the number in their names that counts them, sorted by it."""
    return by_number([path for path in folder.glob(pattern) if not hidden(path) and path.suffix.lower() in suffixes])


def hidden(path: Path) -> bool:
    """Whether a file is half-written, or made by a file manager."""
    return path.name.startswith(".")


def by_number(paths: Sequence[Path]) -> dict[float, Path]:
    """Files by the number in their names that counts them, sorted by it; those without a number are left out."""
    files: dict[float, Path] = {}
    for path, text in zip(paths, counting_numbers([path.stem for path in paths])):
        if text is not None and (number := float(text)) in files:
            raise RecordingError(f"{path.parent}: {files[number].name} and {path.name} have the same number: remove one")
        if text is not None:
            files[float(text)] = path
    return dict(sorted(files.items()))
