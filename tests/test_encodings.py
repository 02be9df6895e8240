import math

import torch

from idfslam.mapping.encodings import PositionalEncoding


def test_hand_worked_values() -> None:
    # wavelength 4 m: phases pi/2 x and pi x. At x = 1, y = 0, z = 0.5: sines 1, 0, sin(pi/4), then 0, 0, 1;
    # cosines 0, 1, cos(pi/4), then -1, 1, 0; raw values x * 2/4.
    encoding = PositionalEncoding(2, wavelength=4.0)
    half = math.sqrt(0.5)
    expected = torch.tensor([0.5, 0, 0.25, 1, 0, half, 0, 0, 1, 0, 1, half, -1, 1, 0])
    torch.testing.assert_close(encoding(torch.tensor([1.0, 0, 0.5])), expected, atol=1e-6, rtol=0)


def test_out_dim_and_batch_shapes() -> None:
    for include_input, width in ((True, 51), (False, 48)):  # 3 * (2 * 8) and the raw 3
        encoding = PositionalEncoding(8, include_input)
        assert encoding.out_dim == width
        assert encoding(torch.zeros(2, 5, 3)).shape == (2, 5, width)


def test_no_frequencies_leave_the_input() -> None:
    assert PositionalEncoding(0, wavelength=2.0)(torch.tensor([0.1, 0.2, 0.3])).tolist() == torch.tensor([0.1, 0.2, 0.3]).tolist()


def test_waves_repeat_but_the_raw_value_tells_places_apart() -> None:
    encoding = PositionalEncoding(3, wavelength=10.0)
    here, beyond = encoding(torch.tensor([[1.0, 2, 3], [11.0, 2, 3]]))
    torch.testing.assert_close(here[3:], beyond[3:], atol=1e-4, rtol=0)
    assert beyond[0] - here[0] == 2.0


def test_gradient() -> None:
    points = torch.randn(4, 3, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(PositionalEncoding(4).double(), points)
