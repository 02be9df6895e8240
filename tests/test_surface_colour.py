"""The colours of a surface from images."""

import numpy as np
import pytest
import trimesh

from helpers.painted_wall import BOX, CAMERA, HALF, WALL, at, painted
from idfslam.views.encoded_view import encode
from idfslam.views.image_archive import ImageArchive, archive_of
from idfslam.views.surface_colour import (
    as_exposed,
    compiled_gather,
    from_images,
    of_archive,
    of_frames,
    plain_gather,
    recoloured,
    seen_colours,
)

NORMAL = np.array([[0.0, 0.0, -1.0]], np.float32)


def archive(places: list[float], gains: list[float] | None = None) -> ImageArchive:
    frames = [painted(i, at(x), gain) for i, (x, gain) in enumerate(zip(places, gains or [1.0] * len(places)))]
    return archive_of([encode(frame, 0.5) for frame in frames], CAMERA, np.stack([at(x) for x in places]))


def wall(xs: np.ndarray, ys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points of the wall beside the box, and their colours."""
    x, y = (part.ravel() for part in np.meshgrid(xs, ys))
    colour = 0.45 + 0.2 * np.stack([np.sin(12 * x), np.cos(9 * y), np.sin(7 * (x + y))], -1)
    return np.stack([x, y, np.full(len(x), WALL)], -1).astype(np.float32), colour.astype(np.float32)


def test_colours_are_those_of_the_scene() -> None:
    images = archive([-0.1, 0.0, 0.1])
    points, colour = wall(np.linspace(0.5, 0.9, 30), np.linspace(-0.5, 0.5, 30))
    found, seen = seen_colours(points, np.repeat(NORMAL, len(points), 0), lambda: of_archive(images))
    assert seen.all()
    assert np.abs(found - colour).mean() < 0.01


def test_a_point_that_no_image_sees_has_no_colour_of_one() -> None:
    images = archive([0.0])
    points = np.array(
        [[0.0, 0.0, WALL], [0.7, 0.0, WALL], [0.0, 0.0, BOX], [5.0, 0.0, WALL]], np.float32
    )  # behind the box, seen, seen, out
    assert seen_colours(points, np.repeat(NORMAL, 4, 0), lambda: of_archive(images))[1].tolist() == [False, True, True, False]
    assert not seen_colours(points, np.repeat(-NORMAL, 4, 0), lambda: of_archive(images))[1].any()  # backs of faces
    blue = np.array([0, 0, 1], np.float32)
    shade = from_images(lambda: of_archive(images), lambda points, normals: np.repeat(blue[None], len(points), 0))
    assert (shade(points, np.repeat(NORMAL, 4, 0))[[0, 3]] == blue).all()


def test_one_image_of_several_that_shows_something_else_hardly_counts() -> None:
    T = np.eye(4)
    frames = [(painted(i, T), T) for i in range(5)]
    frames[2] = (painted(2, T, gain=0.2), T)
    points, colour = wall(np.linspace(0.5, 0.9, 10), np.linspace(-0.5, 0.5, 10))
    found, _ = seen_colours(points, np.repeat(NORMAL, len(points), 0), lambda: of_frames(frames))
    assert np.abs(found - colour).mean() < 0.02  # the mean of all is 0.07 off


def test_exposures_are_taken_out() -> None:
    gains = [1.0, 1.15, 1.3, 1.15, 1.0, 1.15, 1.3]
    images = archive([0.05 * i for i in range(7)], gains)
    points, colour = wall(np.linspace(0.5, 0.9, 30), np.linspace(-0.5, 0.5, 30))
    found, _ = seen_colours(points, np.repeat(NORMAL, len(points), 0), lambda: of_archive(images))
    assert np.median(found / colour) == pytest.approx(1.15, abs=0.04)  # the median of them
    assert np.abs(found - 1.15 * colour).mean() < 0.02
    np.testing.assert_allclose(as_exposed(images, colour), 1.15 * colour, atol=0.04)


def test_a_mesh_gets_them_at_its_vertices() -> None:
    mesh = trimesh.creation.box((2 * HALF, 2 * HALF, 0.2), transform=trimesh.transformations.translation_matrix((0, 0, BOX + 0.1)))
    mesh = mesh.subdivide().subdivide().subdivide()
    mesh.visual.vertex_colors = np.tile(np.array([0, 0, 255, 255], np.uint8), (len(mesh.vertices), 1))
    found = recoloured(mesh, archive([-0.05, 0.05]))
    np.testing.assert_array_equal(found.faces, mesh.faces)
    colours = np.asarray(found.visual.vertex_colors)[:, :3]
    back, front = mesh.vertices[:, 2] > BOX + 0.15, (mesh.vertices[:, 2] < BOX + 0.01) & (np.abs(mesh.vertices[:, :2]) < HALF - 0.05).all(1)
    assert (colours[back] == [0, 0, 255]).all()
    x, y = mesh.vertices[front, 0], mesh.vertices[front, 1]
    true = 0.55 + 0.2 * np.stack([np.sin(12 * x), np.cos(9 * y), np.sin(7 * (x + y))], -1)
    assert np.abs(colours[front] / 255 - true).mean() < 0.03


def test_the_compiled_form_is_the_plain_one() -> None:
    images = archive([-0.3, 0.0, 0.2], [1.0, 1.1, 1.2])
    points, colour = wall(np.linspace(-0.9, 0.9, 40), np.linspace(-0.6, 0.6, 30))
    normals = np.random.default_rng(0).normal(0, 0.4, points.shape).astype(np.float32) + NORMAL
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    for expected in (None, colour):
        sums = []
        for gather in (compiled_gather, plain_gather):
            total, weights = np.zeros((len(points), 3), np.float32), np.zeros(len(points), np.float32)
            for image in of_archive(images):
                gather(points, normals, image, expected, total, weights)
            sums.append((total, weights))
        np.testing.assert_array_equal(sums[0][1] > 0, sums[1][1] > 0)
        assert 0.5 < (sums[0][1] > 0).mean() < 0.99
        np.testing.assert_allclose(sums[0][1], sums[1][1], rtol=2e-3, atol=1e-6)
        np.testing.assert_allclose(sums[0][0], sums[1][0], rtol=5e-3, atol=1e-5)
