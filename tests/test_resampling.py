"""Colour and depth of different sizes brought to one: planes stay planes, edges stay edges, nothing is invented."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from idfslam.datasets.images.resampling import OneView, downscaled_colour, limited_size, upscaled_depth


@pytest.mark.parametrize(
    ("size", "expected"),
    [((1920, 1440), (640, 480)), ((720, 960), (480, 640)), ((1920, 1080), (640, 360)), ((640, 480), (640, 480)), ((16, 12), (16, 12))],
)
def test_moderate_sizes(size: tuple[int, int], expected: tuple[int, int]) -> None:
    assert limited_size(*size) == expected


def test_colour_is_averaged() -> None:
    image = np.zeros((4, 4, 3), np.uint8)
    image[:, 1::2] = 100  # stripes
    assert np.array_equal(downscaled_colour(image, (2, 2)), np.full((2, 2, 3), 50))


@given(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.sampled_from([(640, 480), (300, 200), (256, 192)]))
def test_a_plane_stays_a_plane(a: float, b: float, size: tuple[int, int]) -> None:
    """Inverse depth is affine over the image: 1 / z = 0.5 + a u + b v with u, v in [0, 1]."""

    def plane(width: int, height: int) -> np.ndarray:
        v, u = np.mgrid[:height, :width] + 0.5
        return 1 / (0.9 + a * u / width + b * v / height)

    out = upscaled_depth(plane(256, 192).astype(np.float32), size)
    inner = np.s_[2:-2, 2:-2]  # the outermost half pixel has nothing to lie between
    np.testing.assert_allclose(out[inner], plane(*size)[inner], rtol=1e-5)


def test_an_edge_stays_an_edge() -> None:
    """1 m beside 3 m, 4 pixels made 10: no value between them, and the edge in the middle."""
    out = upscaled_depth(np.array([[1000, 1000, 3000, 3000]] * 2, np.uint16), (10, 2))
    np.testing.assert_allclose(out[0], [1000.0] * 5 + [3000.0] * 5, rtol=1e-6)


def test_a_missing_reading_stays_missing_and_its_neighbours_keep_theirs() -> None:
    raw = np.full((4, 4), 1000, np.uint16)
    raw[1, 1], raw[2, 2] = 0, 65535
    out = upscaled_depth(raw, (8, 8))
    expected = np.kron(np.where((raw == 0) | (raw == 65535), 0, 1000), np.ones((2, 2)))
    np.testing.assert_allclose(out, expected, rtol=1e-6)


def test_fractions_that_are_not_finite_are_no_readings() -> None:
    raw = np.array([[np.nan, np.inf], [-1.0, 2.0]], np.float32)
    assert np.array_equal(upscaled_depth(raw, (4, 4)), np.kron([[0, 0], [0, 2]], np.ones((2, 2))))
    assert upscaled_depth(np.ones((1, 1), np.float32), (3, 2)).tolist() == [[1, 1, 1], [1, 1, 1]]


@given(st.lists(st.integers(0, 4000), min_size=12, max_size=12))
def test_every_value_lies_between_those_of_its_neighbours(values: list[int]) -> None:
    raw = np.array(values, np.uint16).reshape(3, 4)
    out = upscaled_depth(raw, (9, 7))
    assert out.max() <= raw.max() * 1.0001
    assert (out[out > 0] >= min((v for v in values if v), default=0) * 0.9999).all()


# ----- one view in two sizes


@pytest.mark.parametrize(
    ("colour", "depth", "size"),
    [
        ((640, 480), (320, 240), (640, 480)),
        ((1920, 1440), (256, 192), (640, 480)),
        ((1920, 1440), (960, 720), (960, 720)),
        ((320, 240), (640, 480), (320, 240)),
        ((1296, 968), (640, 478), (640, 478)),
    ],
)
def test_the_size_of_one_view(colour: tuple[int, int], depth: tuple[int, int], size: tuple[int, int]) -> None:
    assert OneView.fits(colour, depth)
    bgr, raw = OneView(colour, depth)(np.full((*colour[::-1], 3), 7, np.uint8), np.full(depth[::-1], 1500, np.uint16))
    assert bgr.shape == (*size[::-1], 3)
    assert raw.shape == size[::-1]
    assert (raw == 1500).all()


def test_views_of_other_proportions_are_not_one() -> None:
    for colour, depth in (((640, 480), (512, 424)), ((1280, 720), (640, 576)), ((16, 12), (8, 5)), ((640, 480), (240, 320))):
        assert not OneView.fits(colour, depth)


def test_depth_that_is_larger_than_colour_keeps_its_readings() -> None:
    raw = np.arange(1, 17, dtype=np.uint16).reshape(4, 4)
    _, small = OneView((2, 2), (4, 4))(np.zeros((2, 2, 3), np.uint8), raw)
    assert small.dtype == np.uint16 and np.isin(small, raw).all() and small.shape == (2, 2)
