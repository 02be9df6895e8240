"""The camera that an adjustment estimates: its pinhole, its lens and its depth."""

from dataclasses import astuple

import numpy as np
import pytest

from helpers.point_problem import CAMERA, values
from idfslam.adjustment.camera_model import CameraModel


def test_deviations_are_of_the_stated_camera() -> None:
    model = CameraModel(CAMERA, values(focal=0.1, aspect=0.01, cx=0.01, cy=-0.02))
    assert astuple(model.camera) == pytest.approx((320, 240, 319.0, 319.968, 161.2, 114.6))
    assert CameraModel.as_stated(CAMERA).camera == CAMERA


def test_rays_are_the_inverse_of_projection() -> None:
    model = CameraModel(CAMERA, values(focal=0.02, k1=0.08, k2=-0.05))
    uv = np.array([[0.0, 0.0], [319.0, 100.0], [158.0, 121.0], [40.5, 200.25]])
    np.testing.assert_allclose(model.project(3.0 * model.rays(uv))[0], uv, atol=1e-4)


def test_distortion_is_opencv_s() -> None:
    """At x = 0.5, y = 0, k1 = 0.1: x (1 + 0.1 * 0.25) = 0.5125."""
    model = CameraModel(CAMERA, values(k1=0.1))
    np.testing.assert_allclose(model.project(np.array([[1.0, 0.0, 2.0]]))[0], [[290 * 0.5125 + 158, 121]])


def test_factor_and_deformation_together_are_the_model_s_depth() -> None:
    model = CameraModel(CAMERA, values(depth_scale=0.03, range=0.02, across=0.004, along=-0.003, across2=0.005, along2=0.006))
    depth = np.linspace(0.5, 4.0, 320 * 240).reshape(240, 320).astype(np.float32)
    depth[5, 7] = 0
    v, u = np.mgrid[:240, :320]
    expected = model.depth(np.stack([u.ravel(), v.ravel()], 1).astype(np.float64), depth.ravel().astype(np.float64))[0].reshape(240, 320)
    corrected = model.deformation.corrected(depth * np.float32(model.depth_factor))
    np.testing.assert_allclose(corrected, expected, rtol=2e-6)
    assert corrected[5, 7] == 0
