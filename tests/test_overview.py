"""The picture of a run: the room from outside with the path in it."""

from pathlib import Path

import cv2
import numpy as np
import trimesh

from idfslam.geometry.camera import Camera
from idfslam.pictures.image_files import RenderedView
from idfslam.pictures.mesh_renderer import looking_at
from idfslam.pictures.overview import draw_overview, frustum

CAMERA = Camera(32, 24, 32.0, 32.0, 15.5, 11.5)


def walk() -> np.ndarray:
    """(8, 4, 4) cameras that go round the middle of the room and look outwards; down is +y."""
    angles = np.arange(8) * np.pi / 4
    eyes = np.stack([0.8 * np.cos(angles), np.zeros(8), 0.8 * np.sin(angles)], -1)
    return np.stack([looking_at(2 * eye + [0, 0.3, 0], eye, np.array([0.0, -1.0, 0.0])) for eye in eyes])


def test_a_frustum_opens_towards_its_view() -> None:
    T_wk = np.eye(4)
    T_wk[:3, 3] = [1.0, 2.0, 3.0]
    border, *edges = frustum(T_wk, CAMERA)
    assert border.shape == (5, 3)
    assert (border[0] == border[-1]).all()
    np.testing.assert_allclose(border[:, 2], 3.22)
    np.testing.assert_allclose(border[0, :2], [1 - 0.22 * 15.5 / 32, 2 - 0.22 * 11.5 / 32])
    assert len(edges) == 4
    assert all((edge[0] == [1, 2, 3]).all() for edge in edges)


def test_the_path_is_drawn_in_the_room_and_two_views_beside_it(tmp_path: Path) -> None:
    room = trimesh.creation.box((4.0, 2.5, 4.0)).subdivide().subdivide()
    room.visual.vertex_colors = np.tile(np.array([0, 180, 0, 255], np.uint8), (len(room.vertices), 1))
    red, blue = np.zeros((24, 32, 3), np.float32), np.zeros((24, 32, 3), np.float32)
    red[..., 0], blue[..., 2] = 1, 1
    view = RenderedView(5, red, np.ones((24, 32), np.float32), blue, np.ones((24, 32), np.float32))
    draw_overview(tmp_path / "overview.png", room, walk(), np.array([0, 4]), CAMERA, view)
    image = cv2.imread(str(tmp_path / "overview.png"))[..., ::-1].astype(int)
    assert image.shape == (720, 1440, 3)
    assert (image[100, 1200] == [255, 0, 0]).all()  # the recorded view
    assert (image[460, 1200] == [0, 0, 255]).all()  # the rendered one
    assert (image[5, 5] == 237).all()  # nothing there: 0.93 of 255
    left = image[:, :960]
    green = (left[..., 1] > 60) & (left[..., 0] < 10) & (left[..., 2] < 10)
    assert green.mean() > 0.3  # floor and far walls, seen through the ceiling
    path = (np.abs(left - [31, 92, 219]) < 30).all(-1)
    assert 500 < path.sum() < 10_000
    frusta = (np.abs(left - [214, 84, 20]) < 40).all(-1)
    assert frusta.sum() > 100
