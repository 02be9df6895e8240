"""Where a pose puts the patches of a keyframe in another image, compiled by Numba. `patch_search` has the plain form."""

from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def predict(uv, points, normals, T_oh, camera, distortion, limits, number, start, warp, depth) -> int:  # type: ignore[no-untyped-def]
    """Fills what `patch_search.Predicted` has, for the patches that another image may show; returns how many these are.

    uv (N, 2) [px], points (N, 3) [m], normals (N, 3): of the patches. T_oh (4, 4). camera: width, height, fx, fy, cx, cy of both images.
    distortion: k1, k2. limits: least depth [m], least cosine between a ray and its surface, least and largest ratio of areas.
    """
    width, height, fx, fy, cx, cy = camera
    k1, k2 = distortion
    nearest, grazing, least, largest = limits
    count = 0
    for n in range(len(uv)):
        x, y, z = points[n]
        u, v, w = _moved(T_oh, x, y, z)
        if not w > nearest:
            continue
        r2 = (u * u + v * v) / (w * w)
        stretch = 1 + r2 * (k1 + r2 * k2)
        flat_u, flat_v = u / w * fx + cx, v / w * fy + cy
        start_u, start_v = u / w * stretch * fx + cx, v / w * stretch * fy + cy
        if not (-0.5 < start_u < width - 0.5 and -0.5 < start_v < height - 0.5):
            continue
        nx, ny, nz = normals[n]
        to_plane = x * nx + y * ny + z * nz
        ray_u, ray_v = (uv[n, 0] - cx) / fx, (uv[n, 1] - cy) / fy
        a, c = _beside(T_oh, ray_u + 1 / fx, ray_v, nx, ny, nz, to_plane, grazing, fx, fy, cx - flat_u, cy - flat_v)
        b, d = _beside(T_oh, ray_u, ray_v + 1 / fy, nx, ny, nz, to_plane, grazing, fx, fy, cx - flat_u, cy - flat_v)
        area = a * d - b * c
        if not least < area < largest:
            continue
        number[count], depth[count] = n, w
        start[count, 0], start[count, 1] = start_u, start_v
        warp[count, 0, 0], warp[count, 0, 1], warp[count, 1, 0], warp[count, 1, 1] = d / area, -b / area, -c / area, a / area
        count += 1
    return count


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _moved(T, x, y, z):  # type: ignore[no-untyped-def]
    """A point in another frame."""
    return (
        T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3],
        T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3],
        T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3],
    )


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _beside(T, ray_u, ray_v, nx, ny, nz, to_plane, grazing, fx, fy, cu, cv):  # type: ignore[no-untyped-def]
    """The pixel, from one at (cx - cu, cy - cv) on, that shows where a ray (ray_u, ray_v, 1) meets a patch's plane."""
    along = to_plane / min(ray_u * nx + ray_v * ny + nz, -grazing)
    x, y, z = _moved(T, ray_u * along, ray_v * along, along)
    z = 1e-9 if abs(z) < 1e-9 else z
    return x / z * fx + cu, y / z * fy + cv
