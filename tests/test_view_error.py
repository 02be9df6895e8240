"""PSNR and SSIM of views."""

import numpy as np
import pytest

from idfslam.evaluation.view_error import psnr, ssim, summary, view_error


def noise(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).random((48, 64, 3), np.float32)


def test_psnr_is_that_of_the_mean_squared_error() -> None:
    grey = np.full((10, 10, 3), 0.5, np.float32)
    assert psnr(grey, grey + np.float32(0.1)) == pytest.approx(20, abs=1e-4)
    assert psnr(grey, grey + np.float32(0.01)) == pytest.approx(40, abs=1e-3)
    assert psnr(grey, grey) == 100


def test_ssim_of_known_images() -> None:
    assert ssim(noise(0), noise(0)) == pytest.approx(1)
    assert abs(ssim(noise(0), noise(1))) < 0.05
    black, white = np.zeros((16, 16, 3), np.float32), np.ones((16, 16, 3), np.float32)
    assert ssim(black, white) == pytest.approx(0.01**2 / (1 + 0.01**2), rel=1e-3)  # only the luminance term, with K1 = 0.01


def test_an_exposure_is_taken_out_of_the_matched_value() -> None:
    error = view_error(3, noise(0) * np.float32(0.8), noise(0), np.ones((48, 64), bool), 0.25, 0.5)
    assert error.psnr < 20 < 60 < error.psnr_matched
    assert (error.index, error.holes, error.seconds) == (3, 0.25, 0.5)


def test_pixels_that_the_camera_does_not_fill_do_not_count() -> None:
    lit = np.ones((48, 64), bool)
    lit[:, :8] = False
    recorded, rendered = noise(0) * lit[..., None], noise(0) + np.float32(0.1) * lit[..., None]
    error = view_error(0, rendered.astype(np.float32), recorded.astype(np.float32), lit, 0.0, 0.0)
    assert error.psnr == pytest.approx(20, abs=1e-3)
    assert view_error(0, noise(0), recorded.astype(np.float32), lit, 0.0, 0.0).ssim == pytest.approx(1)


def test_the_summary_has_means() -> None:
    errors = [view_error(i, noise(0), noise(i), np.ones((48, 64), bool), 0.1 * i, 1.0) for i in (1, 2)]
    found = summary(errors)
    assert found["count"] == 2
    assert found["psnr"] == pytest.approx((errors[0].psnr + errors[1].psnr) / 2)
    assert found["holes"] == pytest.approx(0.15)
    assert [view["index"] for view in found["views"]] == [1, 2]
