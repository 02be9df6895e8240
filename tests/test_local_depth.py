"""Depth at a point of an image, from the readings around it."""

import numpy as np

from idfslam.adjustment.local_depth import local_depth

UV = np.array([[30.3, 20.6], [12.0, 30.0]])


def plane(a: float, b: float, c: float) -> np.ndarray:
    """(48, 64) depth of a plane, whose inverse is a + b u + c v."""
    v, u = np.mgrid[:48, :64]
    return (1 / (a + b * u + c * v)).astype(np.float32)


def test_exact_on_a_slanted_plane() -> None:
    z, sigma, slope = local_depth(plane(0.4, 0.002, -0.001), UV)
    np.testing.assert_allclose(z, 1 / (0.4 + 0.002 * UV[:, 0] - 0.001 * UV[:, 1]), rtol=1e-5)
    assert (sigma < 0.003).all()
    np.testing.assert_allclose(slope, -(z[:, None] ** 2) * [0.002, -0.001], rtol=1e-3)


def test_noise_is_averaged_and_sigma_tells_it() -> None:
    rng = np.random.default_rng(0)
    true = plane(0.5, 0.001, 0.0)
    noise = 0.0012 * (1 + 1.5 * (true - 0.4) ** 2)  # that of a Kinect
    off = [local_depth((true + noise * rng.standard_normal(true.shape)).astype(np.float32), UV)[0] for _ in range(200)]
    spread = np.std(off, axis=0)
    z, sigma, _ = local_depth(true, UV)
    np.testing.assert_allclose(np.mean(off, axis=0), z, atol=3e-4)
    np.testing.assert_allclose(np.hypot(spread, 5e-4 * z), np.hypot(sigma - 5e-4 * z, 5e-4 * z), rtol=0.15)


def test_none_at_an_edge_a_hole_or_the_border() -> None:
    depth = plane(0.5, 0.0, 0.0)
    depth[:, 33:] = 2.5
    assert local_depth(depth, UV)[0].tolist()[0] == 0
    hole = plane(0.5, 0.0, 0.0)
    hole[18:24, 26:35] = 0
    assert local_depth(hole, UV)[0].tolist()[0] == 0
    assert local_depth(plane(0.5, 0.0, 0.0), np.array([[1.0, 20.0]]))[0].tolist() == [0]
