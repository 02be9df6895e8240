"""The noise of an image, by hand and on a painted wall."""

import pytest
import torch

from idfslam.sensing.image_noise import noise_of
from test_photometric import EYE, view


def test_one_pixel_by_hand() -> None:
    image = torch.zeros(3, 3)
    image[1, 1] = 0.6745 * 6 * 0.01 / 4
    assert noise_of(image) == pytest.approx(0.01)


@pytest.mark.parametrize("noise", [0.003, 0.01, 0.03])
def test_paint_is_no_noise(noise: float) -> None:
    colour, _ = view(EYE, noise=noise)
    assert noise_of(colour[..., 0]) == pytest.approx(noise, rel=0.1)
    assert noise_of(view(EYE)[0][..., 0]) < 2e-4
