"""The depth of a view from the depth images around it."""

import numpy as np
import pytest

from helpers.painted_wall import BOX, CAMERA, WALL, at, painted
from idfslam.geometry.camera import Camera
from idfslam.geometry.depth_view import reduced_view
from idfslam.views.warping import compiled_fused_depth, plain_fused_depth

SMALL = Camera(40, 30, 35.0, 35.0, 19.5, 14.5)


def images(poses: list[np.ndarray], view: np.ndarray, rows: int) -> tuple[np.ndarray, Camera, np.ndarray]:
    views = [reduced_view(T, painted(0, T).depth, CAMERA, rows) for T in poses]
    T_vk = np.stack([(np.linalg.inv(view) @ T)[:3] for T in poses]).astype(np.float32)
    return np.stack([v.depth for v in views]), views[0].camera, T_vk


def test_the_compiled_form_is_the_plain_one() -> None:
    generator = np.random.default_rng(0)
    depths, camera, T_vk = images([at(-0.2), at(0.1, 0.05), at(0.3, 0.0, -0.1)], at(0.05, 0.02, 0.03), 30)
    depths = depths + generator.normal(0, 0.004, depths.shape).astype(np.float32)
    depths[generator.random(depths.shape) < 0.1] = 0
    weights = np.array([1.0, 0.7, 0.4], np.float32)
    expected = plain_fused_depth(depths, camera, T_vk, SMALL, weights)
    found = compiled_fused_depth(depths, camera, T_vk, SMALL, weights)
    assert (expected > 0).mean() > 0.85
    differ = np.abs(found - expected) > 1e-4  # a pixel on the edge of a triangle may fall to either side
    assert differ.mean() < 0.01


def test_depth_is_that_of_the_scene() -> None:
    view = at(0.0)
    depths, camera, T_vk = images([at(-0.15), at(0.15)], view, 60)
    found, true = compiled_fused_depth(depths, camera, T_vk, CAMERA, np.ones(2, np.float32)), painted(0, view).depth
    assert (found > 0).mean() > 0.95  # the rest: silhouettes, and the view's borders
    assert (np.abs(found - true)[found > 0] < 0.01).mean() > 0.99


def test_the_surface_that_most_images_agree_on_wins() -> None:
    depths, camera, T_vk = images([at(0.0)] * 3, at(0.0), 30)
    depths[:2], depths[2] = WALL, BOX
    assert np.allclose(compiled_fused_depth(depths, camera, T_vk, SMALL, np.ones(3, np.float32))[5:-5, 5:-5], WALL)
    weights = np.array([0.1, 0.1, 1.0], np.float32)
    assert np.allclose(compiled_fused_depth(depths, camera, T_vk, SMALL, weights)[5:-5, 5:-5], BOX)


@pytest.mark.parametrize("form", [compiled_fused_depth, plain_fused_depth])
def test_nothing_comes_from_readings_behind_the_camera_or_from_none(form: type) -> None:
    depths, camera, T_vk = images([at(0.0)], at(0.0), 30)
    T_vk[0, 2, 3] = -3.0
    assert not form(depths, camera, T_vk, SMALL, np.ones(1, np.float32)).any()
    assert not form(depths * 0, camera, T_vk * 0 + np.eye(4, dtype=np.float32)[:3], SMALL, np.ones(1, np.float32)).any()
