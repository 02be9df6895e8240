"""The colours of places from the images that see them."""

from dataclasses import replace

import numpy as np
import torch

from helpers.painted_wall import CAMERA, at, painted
from idfslam.geometry.depth_view import reduced_view
from idfslam.views.blending import BlendedImages, compiled_blended, off_edge, plain_blended
from idfslam.views.encoded_view import MOVING


def images(poses: list[np.ndarray]) -> BlendedImages:
    frames = [painted(0, T) for T in poses]
    depths = np.stack([reduced_view(T, frame.depth, CAMERA, 60).depth for T, frame in zip(poses, frames)])
    return BlendedImages(
        CAMERA,
        np.stack([(frame.colour * 255 + 0.5).astype(np.uint8) for frame in frames]),
        depths,
        np.stack([off_edge(depth) for depth in depths]),
        np.stack([np.linalg.inv(T)[:3] for T in poses]).astype(np.float32),
        np.stack([T[:3, 3] for T in poses]).astype(np.float32),
        np.ones(len(poses), np.float32),
        np.full((len(poses), 3), 1 / 255, np.float32),
        np.zeros((len(poses), 3), np.float32),
    )


def points_of(T: np.ndarray) -> np.ndarray:
    """The world's points (N, 3) at the pixels of a camera."""
    local = CAMERA.backproject(torch.from_numpy(painted(0, T).depth)).numpy().reshape(-1, 3)
    return (local @ T[:3, :3].T + T[:3, 3]).astype(np.float32)


def test_the_compiled_form_is_the_plain_one() -> None:
    view, shown = at(0.02, 0.01, 0.05), images([at(-0.1), at(0.1, 0.05), at(0.05, 0.0, 0.2)])
    shown = replace(shown, base=np.array([1, 0.5, 0.8], np.float32), offsets=np.full((3, 3), 0.03, np.float32))
    shown.depths[np.random.default_rng(0).random(shown.depths.shape) < 0.3] = 0
    points = points_of(view)
    points[::50] = np.nan
    expected, found = (form(points, view[:3, 3].astype(np.float32), shown) for form in (plain_blended, compiled_blended))
    np.testing.assert_array_equal(found[1] > 0, expected[1] > 0)
    assert 0.8 < (found[1] > 0).mean() < 0.99
    np.testing.assert_allclose(found[0], expected[0], atol=2e-3)


def test_colours_are_those_of_the_scene() -> None:
    view = at(0.0)
    colour, weights = compiled_blended(points_of(view), np.zeros(3, np.float32), images([at(-0.05), at(0.05)]))
    error = np.abs(colour - painted(0, view).colour.reshape(-1, 3))[weights > 0]
    assert (weights > 0).mean() > 0.97
    assert error.max(-1).mean() < 0.005


def test_what_an_image_cannot_see_has_no_colour_of_it() -> None:
    points, shown = points_of(at(0.0)), images([at(-0.6)])  # the box hides a part of the wall from this image
    weights = compiled_blended(points, np.zeros(3, np.float32), shown)[1].reshape(CAMERA.height, CAMERA.width)
    column = round(CAMERA.cx + CAMERA.fx * 0.38 / 2.0)  # 0.38 m to the right: behind the box, seen from 0.6 m to the left
    assert weights[60, column] == 0
    assert weights[60, 60] > 0


def test_what_moves_has_no_colour() -> None:
    shown = images([at(0.0)])
    shown.depths[0, 20:40, 20:40] = MOVING
    for form in (compiled_blended, plain_blended):
        weights = form(points_of(at(0.0)), np.zeros(3, np.float32), shown)[1].reshape(CAMERA.height, CAMERA.width)
        assert not weights[42:78, 42:78].any()
        assert weights[60, 90] > 0


def test_the_image_with_the_nearest_ray_counts_most() -> None:
    shown = images([at(0.0), at(0.3)])
    shown.colours[0], shown.colours[1] = 50, 250
    colour = compiled_blended(points_of(at(0.0)), np.zeros(3, np.float32), shown)[0].reshape(CAMERA.height, CAMERA.width, 3)
    assert colour[60, 80, 0] < 51 / 255


def test_weights_fall_towards_silhouettes() -> None:
    depth = np.full((40, 40), 2.0, np.float32)
    depth[:, 20:] = 1.0
    found = off_edge(depth)
    assert found[20, 19] == found[20, 20] == np.float32(0.1)
    assert found[20, 5] == found[20, 35] == 1.0
    assert (off_edge(np.full((8, 8), 2.0, np.float32)) == 1).all()
