"""Frames: wrong arrays are refused in one line, and the images of cameras become frames."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from PIL import Image

from idfslam import Camera, Frame
from idfslam.errors import ConfigError, FrameError

CAMERA = Camera(width=8, height=6, fx=7.0, fy=7.0, cx=3.5, cy=2.5)
RGB = np.random.default_rng(0).integers(0, 256, (6, 8, 3), np.uint8)
COLOUR = RGB.astype(np.float32) / 255
DEPTH = np.full((6, 8), 1.5, np.float32)
MILLIMETRES = np.full((6, 8), 1500, np.uint16)


def frame(**values: Any) -> Frame:
    return Frame(**{"index": 0, "timestamp": 0.0, "colour": COLOUR, "depth": DEPTH, "camera": CAMERA, **values})


def changed(image: NDArray[Any], value: float) -> NDArray[Any]:
    """The image with another value in one pixel."""
    image = image.copy()
    image[2, 3] = value
    return image


def test_a_right_frame_keeps_its_arrays() -> None:
    made = frame()
    assert made.colour is COLOUR and made.depth is DEPTH


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"colour": RGB}, r"colour is uint8 of shape \(6, 8, 3\), expected RGB, float32 in 0 to 1 .* Frame.from_images"),
        ({"colour": COLOUR * 255}, r"colour lies in 0 to 249, expected RGB, float32 in 0 to 1 .*: divide by 255"),
        ({"colour": COLOUR - 1}, "colour lies in -1"),
        ({"colour": np.zeros((6, 8, 4), np.float32)}, r"colour is float32 of shape \(6, 8, 4\)"),
        ({"colour": np.zeros((6, 8), np.float32)}, r"colour is float32 of shape \(6, 8\)"),
        ({"colour": COLOUR.astype(np.float64)}, "colour is float64"),
        ({"colour": changed(COLOUR, np.nan)}, "colour holds NaN or infinity"),
        ({"colour": changed(COLOUR, np.inf)}, "colour holds NaN or infinity"),
        ({"colour": torch.from_numpy(COLOUR)}, "colour is Tensor"),
        ({"colour": None}, "colour is NoneType"),
        ({"depth": MILLIMETRES}, r"depth is uint16 of shape \(6, 8\), expected metres, float32 of shape \(6, 8\)"),
        ({"depth": DEPTH * 1000}, "depth has a median of 1500 m, .*: if it is in millimetres, divide it by 1000"),
        ({"depth": DEPTH.astype(np.float64)}, "depth is float64"),
        ({"depth": DEPTH[:3]}, r"depth is float32 of shape \(3, 8\), expected metres, float32 of shape \(6, 8\): register it"),
        ({"depth": DEPTH[..., None]}, r"depth is float32 of shape \(6, 8, 1\)"),
        ({"camera": replace(CAMERA, width=16)}, r"expected RGB, float32 in 0 to 1 of shape \(6, 16, 3\)"),
        ({"camera": (8, 6, 7.0, 7.0)}, "camera is tuple, expected a Camera"),
        ({"timestamp": np.nan}, "timestamp is nan, expected seconds as a finite number"),
        ({"timestamp": np.inf}, "timestamp is inf"),
        ({"timestamp": None}, "timestamp is None"),
        ({"timestamp": 10**400}, "timestamp is 1000"),
        ({"index": -1}, "index is -1, expected 0 for the first frame"),
        ({"index": 1.5}, "index is 1.5"),
    ],
)
def test_wrong_values_are_refused(values: dict[str, Any], message: str) -> None:
    with pytest.raises(FrameError, match=message) as caught:
        frame(**values)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("nothing", [np.nan, np.inf, -np.inf, -1.0])
def test_what_is_no_depth_becomes_zero(nothing: float) -> None:
    given = changed(DEPTH, nothing)
    np.testing.assert_array_equal(frame(depth=given).depth, changed(DEPTH, 0))
    np.testing.assert_array_equal(given, changed(DEPTH, nothing))  # the caller's array is left alone


def test_single_readings_far_away_are_no_millimetres() -> None:
    assert frame(depth=changed(DEPTH, 655.35)).depth.max() == np.float32(655.35)


def test_views_of_other_arrays_become_contiguous() -> None:
    made = frame(colour=COLOUR[..., ::-1], depth=DEPTH[::-1])
    assert made.colour.flags.c_contiguous and made.depth.flags.c_contiguous
    np.testing.assert_array_equal(made.colour, COLOUR[..., ::-1])


def test_numbers_of_numpy_are_plain_ones() -> None:
    made = frame(index=np.int64(3), timestamp=np.float32(0.5))
    assert (type(made.index), type(made.timestamp), made.index, made.timestamp) == (int, float, 3, 0.5)


@pytest.mark.parametrize(
    ("image", "bgr"),
    [
        (RGB, False),
        (RGB[..., ::-1], True),
        (np.dstack([RGB, np.full((6, 8), 7, np.uint8)]), False),
        (np.dstack([RGB[..., ::-1], np.full((6, 8), 7, np.uint8)]), True),
        (RGB.astype(np.uint16) * 257, False),
        (COLOUR.astype(np.float64), False),
        (torch.from_numpy(RGB), False),
        (Image.fromarray(RGB), False),
        (np.asfortranarray(RGB), False),
    ],
    ids=["rgb", "bgr", "rgba", "bgra", "16 bits", "floats", "tensor", "PIL", "other order"],
)
def test_colour_of_cameras(image: Any, bgr: bool) -> None:
    made = Frame.from_images(image, MILLIMETRES, CAMERA, bgr=bgr)
    assert made.colour.dtype == np.float32 and made.colour.flags.c_contiguous
    np.testing.assert_allclose(made.colour, COLOUR, atol=1e-6)


@pytest.mark.parametrize("grey", [RGB[..., 0], RGB[..., :1]])
def test_grey_becomes_three_equal_channels(grey: NDArray[np.uint8]) -> None:
    np.testing.assert_allclose(Frame.from_images(grey, DEPTH, CAMERA).colour, COLOUR[..., :1].repeat(3, 2), atol=1e-6)


@pytest.mark.parametrize(
    ("image", "scale"),
    [
        (MILLIMETRES, None),
        (MILLIMETRES, 1000.0),
        (MILLIMETRES * 5, 5000),
        (MILLIMETRES.astype(np.int32), None),
        (MILLIMETRES.astype(np.int64), 1000),
        (MILLIMETRES[..., None], None),
        (DEPTH, None),
        (DEPTH.astype(np.float64), None),
        (DEPTH.astype(np.float16), None),
        (DEPTH * 1000, 1000),
        (MILLIMETRES.astype(">u2"), None),
        (torch.from_numpy(DEPTH), None),
    ],
)
def test_depth_of_cameras(image: Any, scale: float | None) -> None:
    made = Frame.from_images(RGB, image, CAMERA, depth_scale=scale)
    assert made.depth.dtype == np.float32 and made.depth.shape == (6, 8)
    np.testing.assert_allclose(made.depth, 1.5, rtol=1e-6)


@pytest.mark.parametrize(
    "image",
    [
        changed(MILLIMETRES, 0),
        changed(MILLIMETRES, 65535),
        changed(MILLIMETRES.astype(np.int32), -1),
        *(changed(DEPTH, nothing) for nothing in (np.nan, np.inf, -2.0)),
        changed(DEPTH.astype(np.float64), 1e308),
    ],
)
def test_what_is_no_reading_of_a_camera_becomes_zero(image: NDArray[Any]) -> None:
    np.testing.assert_allclose(Frame.from_images(RGB, image, CAMERA).depth, changed(DEPTH, 0), rtol=1e-6)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"colour": RGB.transpose(2, 0, 1)}, r"colour is uint8 of shape \(3, 6, 8\), .*: move the channels to the end"),
        ({"colour": COLOUR * 255}, "colour lies in 0 to 249, .*: divide by 255 if it is 0 to 255"),
        ({"colour": RGB.astype(np.int64)}, "colour is int64"),
        ({"colour": [[1, 2], [3]]}, "colour is list, which is no array"),
        ({"colour": RGB[:, :4]}, "colour is 4x6, the camera 8x6, expected one size"),
        ({"colour": "image.png"}, "colour is <U9"),
        ({"depth": MILLIMETRES[:3, :4]}, "depth is 4x3, the camera 8x6, expected one size: register the depth to the colour camera"),
        ({"depth": RGB}, r"depth is uint8 of shape \(6, 8, 3\), expected one channel"),
        ({"depth": DEPTH * 1000}, "depth has a median of 1500 m"),
        ({"depth": None}, "depth is object"),
        ({"depth_scale": 0}, "depth_scale is 0, expected units of the depth image per metre"),
        ({"depth_scale": np.nan}, "depth_scale is nan"),
        ({"depth_scale": "mm"}, "depth_scale is 'mm'"),
        ({"index": "a"}, "index is 'a'"),
    ],
)
def test_wrong_images_are_refused(values: dict[str, Any], message: str) -> None:
    with pytest.raises(FrameError, match=message) as caught:
        Frame.from_images(**{"colour": RGB, "depth": MILLIMETRES, "camera": CAMERA, **values})
    assert "\n" not in str(caught.value)


def test_numbers_and_stamps_of_cameras() -> None:
    assert Frame.from_images(RGB, DEPTH, CAMERA).index == 0
    assert Frame.from_images(RGB, DEPTH, CAMERA, index=3).timestamp == 0.1  # 30 Hz where none is given
    assert Frame.from_images(RGB, DEPTH, CAMERA, index=3, timestamp=7.5).timestamp == 7.5


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("width", value) for value in (0, -8, 8.0)),
        *(("height", value) for value in (True, None)),
        *(("fx", value) for value in (0.0, -7.0)),
        *(("fy", value) for value in (np.nan, np.inf)),
        *(("cx", value) for value in (np.nan, None)),
        *(("cy", value) for value in (np.inf, "3")),
    ],
)
def test_an_impossible_camera_is_refused(name: str, value: Any) -> None:
    with pytest.raises(ConfigError, match=f"camera: {name} is .*, expected pixels"):
        replace(CAMERA, **{name: value})


# ----- what other packages give


@pytest.mark.parametrize("mode", ["P", "CMYK", "YCbCr", "HSV", "LAB"])
def test_pil_images_whose_numbers_are_no_rgb_are_converted(mode: str) -> None:
    image = Image.new("RGB", (8, 6), (200, 40, 40)) if mode != "LAB" else Image.new("LAB", (8, 6), (100, 160, 150))
    image = image if image.mode == mode else image.convert(mode)
    made = Frame.from_images(image, DEPTH, CAMERA)
    np.testing.assert_allclose(made.colour, np.asarray(image.convert("RGB"), np.float32) / 255, atol=1e-6)
    assert made.colour[..., 0].mean() > 0.7 > 0.4 > made.colour[..., 1].mean() or mode == "LAB"


@pytest.mark.parametrize("tensor", [torch.tensor(COLOUR, requires_grad=True), torch.tensor(COLOUR).bfloat16(), torch.tensor(COLOUR).half()])
def test_tensors_of_other_kinds(tensor: torch.Tensor) -> None:
    np.testing.assert_allclose(Frame.from_images(tensor, DEPTH, CAMERA).colour, COLOUR, atol=4e-3)


def test_masked_depth_is_no_reading() -> None:
    masked = np.ma.masked_array(DEPTH, mask=np.arange(48).reshape(6, 8) < 8)
    for made in (Frame.from_images(RGB, masked, CAMERA), frame(depth=masked)):
        assert (made.depth[0] == 0).all() and (made.depth[1:] == 1.5).all()


@pytest.mark.parametrize("kind", [np.int32, np.int64, np.float32])
def test_65535_is_no_reading_in_images_that_were_converted(kind: type) -> None:
    image = MILLIMETRES.astype(kind)
    image[0] = 65535
    assert (Frame.from_images(RGB, image, CAMERA, depth_scale=1000).depth[0] == 0).all()


@pytest.mark.parametrize(
    ("images", "message"),
    [
        ((RGB.astype(np.uint16), DEPTH, CAMERA), "colour is uint16 and nowhere above 255, expected 0 to 65535: convert images of 8 bits"),
        ((RGB, (DEPTH * 100).astype(np.uint8), CAMERA), "depth has 8 bits, too few for millimetres, expected 16 bits"),
        ((RGB, DEPTH * 1000, CAMERA), "give Frame.from_images depth_scale=1000"),
        ((RGB, DEPTH, None), r"camera is NoneType, expected a Camera"),
    ],
)
def test_images_that_are_probably_something_else(images: tuple[Any, Any, Any], message: str) -> None:
    with pytest.raises(FrameError, match=message):
        Frame.from_images(*images)
    with pytest.raises(FrameError, match="depth_scale is True"):
        Frame.from_images(RGB, MILLIMETRES, CAMERA, depth_scale=True)
