"""The smooth error of depth: none by default, known values, and what has no effect on the scale."""

import numpy as np
import pytest

from idfslam.sensing.depth_deformation import DepthDeformation


def test_none_changes_nothing() -> None:
    depth = np.random.default_rng(0).uniform(0, 4, (24, 32)).astype(np.float32)
    assert not DepthDeformation()
    np.testing.assert_array_equal(DepthDeformation().corrected(depth), depth)


@pytest.mark.parametrize(("z", "expected"), [(2.0, 2.0), (4.0, 4.04), (1.0, 0.995), (0.0, 0.0)])
def test_range_is_zero_at_two_metres(z: float, expected: float) -> None:
    corrected = DepthDeformation(range=0.01).corrected(np.full((4, 6), z, np.float32))
    np.testing.assert_allclose(corrected, expected, rtol=1e-6)


def test_terms_of_the_image_have_the_mean_one() -> None:
    deformation = DepthDeformation(across=0.02, along=-0.01, across2=0.03, along2=0.01)
    corrected = deformation.corrected(np.ones((240, 320), np.float32))
    assert corrected.mean() == pytest.approx(1.0, abs=1e-6)
    assert corrected[0, 0] == pytest.approx(1 - 0.02 + 0.01 + (0.03 + 0.01) * 2 / 3, abs=3e-4)


def test_factors_are_those_of_the_image() -> None:
    deformation = DepthDeformation(0.01, 0.002, 0.003, 0.004, 0.005)
    depth = np.full((24, 32), 3.0, np.float32)
    v, u = np.mgrid[:24, :32]
    uv = np.stack([u.ravel(), v.ravel()], 1).astype(np.float64)
    factors = deformation.factors(uv, np.full(len(uv), 3.0), (32, 24))
    np.testing.assert_allclose(deformation.corrected(depth).ravel(), 3 * factors, rtol=1e-6)
