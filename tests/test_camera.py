"""The pinhole camera: projection round trips, resizing, borders."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from idfslam.geometry.camera import Camera
from idfslam.geometry.projection import to_pixel

CAMERA = Camera(8, 6, 10.0, 12.0, 3.2, 2.7)

cameras = st.builds(
    Camera, st.integers(2, 40), st.integers(2, 30), st.floats(5, 600), st.floats(5, 600), st.floats(-5, 45), st.floats(-5, 35)
)


@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float32, 2e-3), (torch.float64, 1e-10)])
@given(camera=cameras, seed=st.integers(0, 1000))
@settings(max_examples=40, deadline=None, derandomize=True)
def test_projection_undoes_backprojection(camera: Camera, seed: int, dtype: torch.dtype, tolerance: float) -> None:
    depth = 0.1 + 5 * torch.rand(camera.height, camera.width, generator=torch.Generator().manual_seed(seed), dtype=dtype)
    points = camera.backproject(depth)
    uv, z = camera.project(points)
    assert points.dtype == dtype and points.shape == (camera.height, camera.width, 3)
    assert torch.equal(z, depth)
    assert (uv - camera.pixels()).abs().max() < tolerance
    assert camera.inside(uv, z).all()


def test_hand_worked_projection() -> None:
    # u = fx x/z + cx = 10 * 1/2 + 3.2 = 8.2; v = 12 * -0.5/2 + 2.7 = -0.3
    uv, z = CAMERA.project(torch.tensor([1.0, -0.5, 2.0], dtype=torch.float64))
    assert uv.tolist() == pytest.approx([8.2, -0.3]) and z.item() == 2
    assert not CAMERA.inside(uv, z)  # u is beyond the right edge at 7.5


def test_matrix_agrees_with_project() -> None:
    point = torch.tensor([0.3, -0.1, 1.7], dtype=torch.float64)
    homogeneous = CAMERA.matrix() @ point
    assert CAMERA.project(point)[0].tolist() == pytest.approx((homogeneous[:2] / homogeneous[2]).tolist())


def test_rays_have_unit_z_and_pixels_are_u_then_v() -> None:
    pixels = CAMERA.pixels()
    assert pixels.shape == (6, 8, 2) and pixels[5, 7].tolist() == [7, 5]
    assert bool((CAMERA.rays(pixels)[..., 2] == 1).all())


def test_inside_ends_at_the_outer_edges_and_in_front() -> None:
    uv = torch.tensor([[-0.5, 0.0], [-0.51, 0.0], [7.49, 5.49], [7.5, 0.0], [0.0, 5.5]])
    assert CAMERA.inside(uv, torch.ones(5)).tolist() == [True, False, True, False, False]
    assert CAMERA.inside(torch.zeros(3, 2), torch.tensor([1.0, 0.0, -1.0])).tolist() == [True, False, False]


def test_the_frustum_is_what_lies_inside() -> None:
    points = torch.randn(2000, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    seen = (points @ torch.from_numpy(CAMERA.frustum()).T > 0).all(-1)
    assert torch.equal(seen, CAMERA.inside(*CAMERA.project(points)))
    assert 50 < seen.sum() < 1000


def test_points_in_the_camera_plane_stay_finite_with_finite_gradients() -> None:
    points = torch.tensor([[1.0, 1.0, 0.0], [0.0, 0.0, 0.0]], requires_grad=True)
    uv, z = CAMERA.project(points)
    (torch.where(CAMERA.inside(uv, z)[:, None], uv, 0.0).sum() + z.sum()).backward()
    assert torch.isfinite(uv).all() and points.grad is not None and torch.isfinite(points.grad).all()


def test_backproject_of_no_depth_is_zero() -> None:
    assert CAMERA.backproject(torch.zeros(6, 8)).abs().max() == 0


@given(camera=cameras, width=st.integers(1, 80), height=st.integers(1, 60))
@settings(max_examples=40, deadline=None, derandomize=True)
def test_resizing_keeps_the_outer_edges(camera: Camera, width: int, height: int) -> None:
    resized = camera.resized(width, height)
    corners = torch.tensor([[-0.5, -0.5], [camera.width - 0.5, camera.height - 0.5]], dtype=torch.float64)
    same = torch.tensor([[-0.5, -0.5], [width - 0.5, height - 0.5]], dtype=torch.float64)
    assert torch.allclose(camera.rays(corners), resized.rays(same), atol=1e-9)
    back = resized.resized(camera.width, camera.height)
    assert (back.fx, back.cy) == (pytest.approx(camera.fx), pytest.approx(camera.cy))


def test_halving_puts_a_new_pixel_between_two_old_ones() -> None:
    half = CAMERA.resized(4, 3)
    # New pixel 0 covers old 0 and 1, whose middle is 0.5
    assert torch.allclose(half.rays(torch.tensor([0.0, 0.0])), CAMERA.rays(torch.tensor([0.5, 0.5])))


@given(x=st.floats(-2, 2), y=st.floats(-2, 2), z=st.floats(0.1, 5))
@settings(max_examples=40, deadline=None, derandomize=True)
def test_the_compiled_projection_is_the_same(x: float, y: float, z: float) -> None:
    uv, _ = CAMERA.project(torch.tensor([x, y, z], dtype=torch.float64))
    assert to_pixel(x, y, z, CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy) == tuple(uv.tolist())


def test_the_camera_of_every_third_pixel() -> None:
    """Pixels 1, 4, 7 ... of 640, and of 481: a point that pixel (4, 7) shows lies in pixel (1, 2)."""
    camera = Camera(640, 481, 525.0, 500.0, 319.5, 239.5)
    small = camera.every(3)
    assert (small.width, small.height) == (213, 160)
    torch.testing.assert_close(small.rays(torch.tensor([1.0, 2.0])), camera.rays(torch.tensor([4.0, 7.0])))


def test_numbers_of_numpy_become_pythons_own() -> None:
    """A camera from the entries of a matrix compared as `np.bool` in the check of the camera, which ended the run with a TypeError."""
    K = np.array([[10.0, 0, 3.2], [0, 12.0, 2.7], [0, 0, 1]])
    camera = Camera(np.int64(8), np.int32(6), K[0, 0], np.float32(12), K[0, 2], K[1, 2])
    assert camera == CAMERA
    assert [type(value) for value in vars(camera).values()] == [int, int, float, float, float, float]
