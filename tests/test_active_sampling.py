import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from idfslam.mapping.active_sampling import allot, cell_of, cell_shares, draw_pixels, group_pixels, initial_cell_losses, update_cell_losses


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def test_cells_by_hand() -> None:
    # A 4 x 6 image in 2 x 2 cells: columns 0-2 and 3-5, rows 0-1 and 2-3.
    uv = torch.tensor([[0, 0], [2, 1], [3, 1], [5, 0], [2, 2], [5, 3]])
    assert cell_of(uv, 4, 6, 2).tolist() == [0, 0, 1, 1, 2, 3]


def test_cell_losses_by_hand() -> None:
    # Cell 0: pixels with 1 and 3, mean 2. Cell 3: 5. Cells 1 and 2 keep what they had.
    uv = torch.tensor([[0, 0], [2, 1], [5, 3]])
    updated = update_cell_losses(torch.tensor([[9.0, 8], [7, 6]]), uv, torch.tensor([1.0, 3, 5]), 4, 6)
    assert updated.tolist() == [[2, 8], [7, 5]]


def test_shares_by_hand() -> None:
    losses = torch.tensor([[1.0, 2], [4, 1]])
    torch.testing.assert_close(cell_shares(losses), torch.tensor([[1 / 8, 2 / 8], [4 / 8, 1 / 8]]))
    # Reciprocals 1, 1/2, 1/4, 1 sum to 11/4.
    torch.testing.assert_close(cell_shares(losses, invert=True), torch.tensor([[4 / 11, 2 / 11], [1 / 11, 4 / 11]]))


def test_shares_of_nothing_are_even() -> None:
    for invert in (False, True):
        assert cell_shares(torch.zeros(2, 2), invert=invert).tolist() == [[0.25, 0.25], [0.25, 0.25]]
        assert cell_shares(initial_cell_losses(2), invert=invert).tolist() == [[0.25, 0.25], [0.25, 0.25]]


def test_a_perfect_cell_does_not_take_all() -> None:
    shares = cell_shares(torch.tensor([[0.0, 1], [1, 2]]), invert=True)  # mean 1: the zero counts as 0.01, reciprocal 100
    torch.testing.assert_close(shares, torch.tensor([[100.0, 1], [1, 0.5]]) / 102.5)


@settings(max_examples=50, deadline=None)
@given(st.lists(st.floats(0, 100), min_size=4, max_size=16), st.integers(1, 2000), st.integers(0, 1000))
def test_allotment_adds_up_and_follows_the_shares(parts: list[float], count: int, seed: int) -> None:
    shares = torch.tensor(parts, dtype=torch.float64) + 0.01
    counts = allot(shares, count, generator(seed))
    exact = shares / shares.sum() * count
    assert int(counts.sum()) == count
    assert bool(((counts - exact).abs() < 1 + 1e-9).all())


def test_draw_follows_shares_and_mask() -> None:
    allowed = torch.zeros(480, 640, dtype=torch.bool)
    allowed[::3, 80:] = True  # the first column of 8 x 8 cells has none
    pixels = group_pixels(allowed, 8)
    losses = torch.ones(8, 8)
    losses[2, 5] = 9
    uv = draw_pixels(pixels, cell_shares(losses), 1024, generator())
    assert uv.shape == (1024, 2) and uv.dtype == torch.int64
    assert bool(allowed[uv[:, 1], uv[:, 0]].all())
    counts = torch.bincount(cell_of(uv, 480, 640, 8), minlength=64).view(8, 8)
    # 56 cells have pixels; the shares sum to 55 + 9 = 64: 16 pixels a cell and 144 in the bad one.
    assert counts[:, 0].tolist() == [0] * 8
    assert abs(int(counts[2, 5]) - 144) <= 1 and abs(int(counts[0, 1]) - 16) <= 1


def test_inverted_draw_prefers_low_losses() -> None:
    losses = torch.tensor([[1.0, 3], [3, 3]])  # reciprocals 1, 1/3, 1/3, 1/3: half of the pixels go to the first cell
    pixels = group_pixels(torch.ones(10, 10, dtype=torch.bool), 2)
    uv = draw_pixels(pixels, cell_shares(losses, invert=True), 100, generator())
    assert torch.bincount(cell_of(uv, 10, 10, 2))[0] in (49, 50, 51)


def test_even_within_a_cell() -> None:
    pixels = group_pixels(torch.ones(4, 4, dtype=torch.bool), 1)
    uv = draw_pixels(pixels, torch.ones(1, 1), 16000, generator())
    counts = torch.bincount(uv[:, 1] * 4 + uv[:, 0], minlength=16)
    assert int(counts.min()) > 850 and int(counts.max()) < 1150  # 1000 +- 5 standard deviations of 31


def test_draw_is_repeatable_and_empty_images_give_nothing() -> None:
    pixels = group_pixels(torch.ones(33, 47, dtype=torch.bool), 8)
    shares = cell_shares(initial_cell_losses(8))
    assert torch.equal(draw_pixels(pixels, shares, 64, generator(5)), draw_pixels(pixels, shares, 64, generator(5)))
    assert not torch.equal(draw_pixels(pixels, shares, 64, generator(5)), draw_pixels(pixels, shares, 64, generator(6)))
    assert draw_pixels(group_pixels(torch.zeros(33, 47, dtype=torch.bool), 8), shares, 64, generator()).shape == (0, 2)
