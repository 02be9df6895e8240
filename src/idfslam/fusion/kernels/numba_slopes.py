"""The slopes of inverse depth in a depth image, compiled by Numba. `prepared_depth` has the plain form."""

from numba import njit, prange


@njit(cache=True, nogil=True, error_model="numpy", parallel=True)
def slopes(depth, reach, edge, edge_share, along_u, along_v, count):  # type: ignore[no-untyped-def]
    """Fills the slopes (H, W) [1/(m px)] and the number of readings (H, W): regressions over windows of `reach` pixels each way."""
    height, width = depth.shape
    for row in prange(height):
        for column in range(width):
            z = depth[row, column]
            if z <= 0:
                continue
            n, su, sv, sq, suu, suv, svv, suq, svq = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for j in range(max(row - reach, 0), min(row + reach + 1, height)):
                for i in range(max(column - reach, 0), min(column + reach + 1, width)):
                    other = depth[j, i]
                    if other <= 0 or abs(other - z) >= edge + edge_share * z:
                        continue
                    u, v, q = float(i - column), float(j - row), 1.0 / other
                    n += 1
                    su += u
                    sv += v
                    sq += q
                    suu += u * u
                    suv += u * v
                    svv += v * v
                    suq += u * q
                    svq += v * q
            u, v, q = su / n, sv / n, sq / n
            uu, uv, vv, uq, vq = suu / n - u * u, suv / n - u * v, svv / n - v * v, suq / n - u * q, svq / n - v * q
            determinant = uu * vv - uv * uv
            if determinant > 1e-3:
                along_u[row, column] = (vv * uq - uv * vq) / determinant
                along_v[row, column] = (uu * vq - uv * uq) / determinant
                count[row, column] = int(n)
