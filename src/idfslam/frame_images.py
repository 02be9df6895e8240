"""Colour and depth of a frame: checked as SLAM takes them, and converted from what cameras give.

SLAM takes colour (H, W, 3) float32 RGB in [0, 1] and depth (H, W) float32 [m], 0 where there is no reading.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from idfslam.errors import FrameError
from idfslam.geometry.camera import Camera

SATURATED = 65535  # no reading, in depth images of 16 bits: "invalid" in 7-Scenes, the end of the range elsewhere
_TOLERANCE = 1e-3  # [1] by which colour may lie outside [0, 1]; raised, less of it counts as wrong. A quarter of a step of 8 bits
FARTHEST = 100.0  # [m] Depth whose median is larger counts as millimetres; raised, larger scenes pass. Chosen by hand, above any sensor
_CONVERT = "or let Frame.from_images convert it"
_BRIGHTEST_8_BIT = 255
_PIL_MODES = ("1", "P", "PA", "CMYK", "YCbCr", "LAB", "HSV")  # whose numbers are no grey, RGB or RGBA
_METRES, _MILLIMETRES = 1.0, 1000.0  # units per metre
# Every frame comes here, so all that can be wrong is found in one pass. The bits of numbers from +0 on, read as an integer, are in the
# numbers' order; those of negative numbers, infinity and NaN are larger.
_BRIGHTEST, _INFINITE = np.array([1 + _TOLERANCE, np.inf], np.float32).view(np.uint32)


def checked_colour(colour: NDArray[np.float32], camera: Camera) -> NDArray[np.float32]:
    """The image as a contiguous array; raises FrameError if it is not (H, W, 3) float32 in [0, 1] of the camera's size."""
    expected = f"expected RGB, float32 in 0 to 1 of shape ({camera.height}, {camera.width}, 3)"
    if _dtype(colour) != np.float32 or colour.shape != (camera.height, camera.width, 3):
        raise FrameError(f"colour is {_described(colour)}, {expected}: convert it, {_CONVERT}")
    image = np.ascontiguousarray(colour)
    if image.view(np.uint32).max() <= _BRIGHTEST:
        return image
    low, high = float(colour.min()), float(colour.max())  # NaN if any value is
    if not np.isfinite(low + high):
        raise FrameError(f"colour holds NaN or infinity, {expected}: replace these values")
    if low < -_TOLERANCE or high > 1 + _TOLERANCE:
        raise FrameError(f"colour lies in {low:.4g} to {high:.4g}, {expected}: divide by 255 if it is 0 to 255")
    return image


def checked_depth(depth: NDArray[np.float32], camera: Camera) -> NDArray[np.float32]:
    """The image as a contiguous array, 0 in place of NaN, infinity and negative values, which are no readings.

    Raises FrameError if it is not (H, W) float32 of the camera's size, or if half of the readings are more than 100 m away.
    """
    expected = f"expected metres, float32 of shape ({camera.height}, {camera.width})"
    if _dtype(depth) != np.float32 or depth.shape != (camera.height, camera.width):
        raise FrameError(f"depth is {_described(depth)}, {expected}: register it to the colour camera and convert it, {_CONVERT}")
    if isinstance(depth, np.ma.MaskedArray):
        depth = depth.filled(0)
    depth = np.ascontiguousarray(depth)
    if depth.view(np.uint32).max() >= _INFINITE:
        depth = np.where(np.isfinite(depth) & (depth > 0), depth, np.float32(0))
    farthest = depth.view(np.uint32).max().view(np.float32)
    if farthest > FARTHEST and (median := float(np.median(depth[depth > 0]))) > FARTHEST:
        mend = "if it is in millimetres, divide it by 1000, or give Frame.from_images depth_scale=1000"
        raise FrameError(f"depth has a median of {median:.4g} m, {expected}: {mend}")
    return depth


def colour_from(image: ArrayLike, camera: Camera, *, bgr: bool) -> NDArray[np.float32]:
    """(H, W, 3) float32 RGB in [0, 1] from grey (H, W[, 1]), colour (H, W, 3) or colour with alpha (H, W, 4).

    Integers count from 0 to the largest value of their type (uint8: 255), floats from 0 to 1. bgr: blue comes first, as in OpenCV.
    """
    array = _array(_as_rgb(image), "colour")
    if array.dtype not in (np.uint8, np.uint16) and array.dtype.kind != "f":
        raise FrameError(f"colour is {_described(array)}, expected uint8 from 0 to 255, uint16, or floats from 0 to 1")
    grey = array[..., None] if array.ndim == 2 else array
    if grey.ndim != 3 or grey.shape[2] not in (1, 3, 4):
        hint = ": move the channels to the end" if array.ndim == 3 and array.shape[0] in (1, 3, 4) else ""
        raise FrameError(f"colour is {_described(array)}, expected (H, W), (H, W, 3) or (H, W, 4){hint}")
    _check_size(grey, camera, "colour")
    if array.dtype == np.uint16 and 0 < array.max() <= _BRIGHTEST_8_BIT:
        raise FrameError("colour is uint16 and nowhere above 255, expected 0 to 65535: convert images of 8 bits to uint8")
    rgb = np.repeat(grey, 3, axis=2) if grey.shape[2] == 1 else grey[..., 2::-1] if bgr else grey[..., :3]
    brightest = np.iinfo(array.dtype).max if array.dtype.kind == "u" else 1
    unit: NDArray[np.float32] = np.multiply(rgb, np.float32(1 / brightest), dtype=np.float32)
    return unit


def depth_from(image: ArrayLike, camera: Camera, *, depth_scale: float | None) -> NDArray[np.float32]:
    """(H, W) float32 [m] from integers or floats, with 0 where there is no reading: 0, negative, NaN, infinity, 65535, masked.

    depth_scale: units of the image per metre; None: 1000 for integers (millimetres), 1 for floats (metres).
    """
    array = _array(image, "depth")
    if array.dtype.kind not in "uif":
        raise FrameError(f"depth is {_described(array)}, expected integers in millimetres or floats in metres")
    flat = array[..., 0] if array.ndim == 3 and array.shape[2] == 1 else array
    if flat.ndim != 2:
        raise FrameError(f"depth is {_described(array)}, expected one channel, (H, W)")
    _check_size(flat, camera, "depth")
    if array.dtype.itemsize == 1 and depth_scale is None:
        raise FrameError("depth has 8 bits, too few for millimetres, expected 16 bits or more: give depth_scale if 8 are meant")
    scale = depth_scale if depth_scale is not None else _METRES if array.dtype.kind == "f" else _MILLIMETRES
    if isinstance(scale, bool) or not (isinstance(scale, int | float | np.number) and 0 < scale < np.inf):
        raise FrameError(f"depth_scale is {scale!r}, expected units of the depth image per metre, such as 1000 for millimetres")
    with np.errstate(over="ignore", invalid="ignore"):  # what overflows is infinite, and so no reading
        readings = np.isfinite(flat) & (flat > 0) & (flat != SATURATED)  # also in images that were 16 bits before they were converted
        depth = np.multiply(flat, np.float32(1 / scale), dtype=np.float32, casting="unsafe")
    return np.where(readings, depth, np.float32(0))


def _check_size(image: NDArray[Any], camera: Camera, kind: str) -> None:
    if image.shape[:2] != (camera.height, camera.width):
        found = f"{kind} is {image.shape[1]}x{image.shape[0]}, the camera {camera.width}x{camera.height}"
        raise FrameError(f"{found}, expected one size: register the depth to the colour camera, or resize the image and the camera")


def _as_rgb(image: Any) -> Any:
    """A PIL image as RGB if its numbers mean something else, such as the colours of a palette; all else as it is."""
    return image.convert("RGB") if getattr(image, "mode", None) in _PIL_MODES and callable(getattr(image, "convert", None)) else image


def _array(image: Any, kind: str) -> NDArray[Any]:
    """What `numpy.asarray` makes of it; a tensor that has a gradient or is on a GPU is copied, and what is masked is 0."""
    try:
        if callable(getattr(image, "detach", None)):
            image = image.detach().cpu()
            image = image.float() if str(image.dtype) == "torch.bfloat16" else image
        return image.filled(0) if isinstance(image, np.ma.MaskedArray) else np.asarray(image)
    except Exception as error:  # whatever a class of another package raises
        found = f"{type(image).__name__}, which is no array ({type(error).__name__})"
        raise FrameError(f"{kind} is {found}, expected a numpy array or what numpy.asarray takes") from error


def _dtype(image: Any) -> Any:
    return image.dtype if isinstance(image, np.ndarray) else None


def _described(image: Any) -> str:
    return f"{image.dtype} of shape {image.shape}" if isinstance(image, np.ndarray) else type(image).__name__
