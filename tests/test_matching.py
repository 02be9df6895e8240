"""Matching on hand-made features: ratio weights, both directions, the mutual check, and the grid's limit."""

import math

import pytest
import torch
from torch import Tensor

from idfslam.tracking.matching import Features, PixelMatches, bucket, features_in, match, nearest, ratio_weights, two_largest


def at(*degrees: float) -> Tensor:
    """(N, 2) unit features at these angles."""
    return torch.tensor([[math.cos(math.radians(d)), math.sin(math.radians(d))] for d in degrees], dtype=torch.float64)


def image(*degrees: float) -> Features:
    """The same as an image of one row."""
    return features_in(at(*degrees).mT[:, None])


def everywhere(width: int) -> Tensor:
    return torch.ones(1, width, dtype=torch.bool)


def test_ratio_weight_by_hand() -> None:
    # Query at 0 degrees, neighbours at 60 and 90: d = 1 - cos = 0.5 and 1; w = 1 - 0.5/1 = 0.5.
    # Query at 90: neighbours at 90 (d clamped to 1e-6) and 60 (d = 1 - cos 30 = 0.1339746): w = 1 - 7.46e-6.
    queries, targets = at(0, 90), at(90, 60)
    neighbours = nearest(queries, targets)
    assert neighbours.tolist() == [[1, 0], [0, 1]]
    torch.testing.assert_close(ratio_weights(queries, targets, neighbours), torch.tensor([0.5, 1 - 1e-6 / 0.1339746], dtype=torch.float64))


def test_equal_neighbours_weigh_nothing() -> None:
    queries, targets = at(0), at(30, -30)
    assert float(ratio_weights(queries, targets, nearest(queries, targets))) == pytest.approx(0, abs=1e-12)


def test_both_directions() -> None:
    # Frame 0, 40, 90 degrees; keyframe 5, 50 degrees. Frame to keyframe: 0->0, 1->1 (10 from 50, 35 from 5), 2->1 (40 from 50).
    # Keyframe to frame: 5->pixel 0, 50->pixel 1. All five are kept, the frame's first.
    found = match(image(0, 40, 90), image(5, 50), everywhere(3), everywhere(2))
    assert found.frame.tolist() == [0, 1, 2, 0, 1]
    assert found.keyframe.tolist() == [0, 1, 1, 0, 1]


def test_mutual_check_drops_the_one_that_does_not_return() -> None:
    # Frame pixels 0 (0 deg), 1 (200), 2 (230), 3 (90): pixel 3's nearest is keyframe pixel 0 (5 deg), which asked back names pixel 0, three
    # columns away: dropped. The others return.
    found = match(image(0, 200, 230, 90), image(5, 201, 231, 300), everywhere(4), everywhere(4), mutual=True)
    assert found.frame.tolist() == [0, 1, 2]
    assert found.keyframe.tolist() == [0, 1, 2]


def test_pixels_without_depth_take_no_part() -> None:
    valid = torch.tensor([[True, False, True]])
    found = match(image(0, 40, 90), image(41, 1, 89), valid, everywhere(3))
    assert 1 not in found.frame.tolist()


def test_strides_thin_the_lattice() -> None:
    # A stride of 2 asks pixels 1, 3 only (offset stride // 2), in both images.
    row = torch.tensor([[True] * 5] * 3)
    features = torch.nn.functional.normalize(torch.randn(4, 3, 5, generator=torch.Generator().manual_seed(0)), dim=0)
    found = match(features_in(features), features_in(features), row, row, query_stride=2, mutual=True)
    assert found.frame.tolist() == [6, 8]  # row 1, columns 1 and 3
    assert found.keyframe.tolist() == [6, 8]


def test_no_candidates_no_matches() -> None:
    assert len(match(image(0, 40), image(0, 40), torch.zeros(1, 2, dtype=torch.bool), everywhere(2))) == 0


def test_weights_carry_gradients() -> None:
    features = at(0, 40, 90).requires_grad_()
    match(features_in(features.mT[:, None]), image(5, 50), everywhere(3), everywhere(2)).weight.sum().backward()
    assert features.grad is not None
    assert float(features.grad.abs().sum()) > 0


def test_chunks_do_not_change_the_answer() -> None:
    queries, targets = (torch.nn.functional.normalize(torch.randn(600, 8, dtype=torch.float64), dim=1) for _ in range(2))
    assert torch.equal(nearest(queries, targets), (queries @ targets.mT).topk(2).indices)


@pytest.mark.parametrize("columns", [2, 3, 65, 66, 67, 200])
def test_two_largest_are_those_of_topk(columns: int) -> None:
    values = torch.randn(50, columns, generator=torch.Generator().manual_seed(columns))
    assert torch.equal(two_largest(values), values.topk(2, dim=-1).indices)


def test_grid_limit_by_hand() -> None:
    # A 2 x 2 grid on a 4 x 4 image, K = 4: one a cell. Pixels 0, 1, 4, 5 lie in the first cell, 2 in the second, 15 in the last.
    # Best first by weight: 1 (0.9), 0 (0.8: its cell is full), 15 (0.5), 2 (0.3).
    frame = torch.tensor([0, 1, 2, 15])
    matches = PixelMatches(frame, frame, torch.tensor([0.8, 0.9, 0.3, 0.5]))
    assert bucket(matches, (4, 4), limit=4, grid=2).frame.tolist() == [1, 15, 2]


def test_grid_of_one_is_plain_top_k() -> None:
    frame = torch.tensor([0, 1, 2, 15])
    matches = PixelMatches(frame, frame, torch.tensor([0.8, 0.9, 0.3, 0.5]))
    assert bucket(matches, (4, 4), limit=2, grid=1).frame.tolist() == [1, 0]


def test_limit_holds_over_all_cells() -> None:
    # K = 200 on 4 x 4: ceil(12.5) = 13 a cell would be 208; no more than 200 are kept.
    frame = torch.arange(64 * 64)
    matches = PixelMatches(frame, frame, torch.rand(64 * 64))
    kept = bucket(matches, (64, 64), limit=200, grid=4)
    assert len(kept) == 200
    cells = (kept.frame // 64 // 16) * 4 + kept.frame % 64 // 16
    assert int(torch.bincount(cells).max()) <= 13
