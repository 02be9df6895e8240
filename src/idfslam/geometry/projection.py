"""The pinhole projection for compiled loops; `Camera.project` is its form for tensors."""

from typing import TypeAlias

from numba import njit

from idfslam.geometry.camera import Camera

Intrinsics: TypeAlias = tuple[float, float, float, float]  # fx, fy, cx, cy [px]


def intrinsics_of(camera: Camera) -> Intrinsics:
    """The focal lengths and the principal point, as `project` takes them."""
    return camera.fx, camera.fy, camera.cx, camera.cy


@njit(cache=True, fastmath=True, forceinline=True)  # why: mapping/kernels/numba_grid.py
def project(T_cw, point, intrinsics):  # type: ignore[no-untyped-def]
    """A world point (3,) [m] -> pixel u, v and depth z [m]; u and v are 0 for a point that is not in front of the camera."""
    fx, fy, cx, cy = intrinsics
    x, y, z = point[0], point[1], point[2]  # taken apart in one step, a row of an array costs as much as all of the rest
    z_c = T_cw[2, 0] * x + T_cw[2, 1] * y + T_cw[2, 2] * z + T_cw[2, 3]
    if z_c <= 0:
        return z_c * 0, z_c * 0, z_c
    u = (T_cw[0, 0] * x + T_cw[0, 1] * y + T_cw[0, 2] * z + T_cw[0, 3]) / z_c * fx + cx
    v = (T_cw[1, 0] * x + T_cw[1, 1] * y + T_cw[1, 2] * z + T_cw[1, 3]) / z_c * fy + cy
    return u, v, z_c


@njit(cache=True, nogil=True, error_model="numpy")
def to_pixel(x: float, y: float, z: float, fx: float, fy: float, cx: float, cy: float) -> tuple[float, float]:
    """The pixel (u, v) of a point (x, y, z) [m] in the camera's frame; meaningful where z > 0. Sums keep the order of `Camera.project`."""
    return x / z * fx + cx, y / z * fy + cy
