"""Coverage: what the mapped views showed, and what of it is hidden since it moves."""

import numpy as np
import torch

from helpers.flat_wall import PAPER, insert, keyframe
from idfslam.graph.coverage import Coverage
from idfslam.graph.frame_poses import FramePoses
from idfslam.graph.keyframe_graph import KeyframeGraph


def covered() -> tuple[Coverage, FramePoses]:
    """Two keyframes before a wall, the second with a hidden column of pixels."""
    frames = FramePoses(KeyframeGraph(PAPER))
    coverage = Coverage(frames.graph)
    for i in range(2):
        new = keyframe(3 * i, 3.0 * i)
        if i:
            new.hide(np.arange(64)[None].repeat(48, 0) == 10)
        insert(frames, new)
        coverage.add(new)
    return coverage, frames


def test_what_moves_is_hidden_and_kept() -> None:
    coverage, _ = covered()
    assert coverage.indices() == [0, 3]
    assert [int((view.depth == 0).sum()) for view in coverage.views()] == [0, 48]
    assert [int((depth.counts == 0).sum()) for _, depth in coverage.packed()] == [0, 48]
    assert [int((depth.counts == 0).sum()) for _, depth in coverage.unmasked()] == [0, 0]


def test_more_is_hidden_later() -> None:
    coverage, _ = covered()
    row = np.zeros((48, 64), np.bool_)
    row[5] = True
    coverage.hide([np.zeros_like(row), row])
    assert [int((view.depth == 0).sum()) for view in coverage.views()] == [0, 48 + 63]
    assert [int((depth.counts == 0).sum()) for _, depth in coverage.packed()] == [0, 48 + 63]
    assert [int((depth.counts == 0).sum()) for _, depth in coverage.unmasked()] == [0, 0]


def test_a_restored_coverage_hides_the_same() -> None:
    coverage, frames = covered()
    again = Coverage(frames.graph)
    again.restore(coverage.state())
    for (_, one), (_, other) in zip(coverage.packed(), again.packed()):
        np.testing.assert_array_equal(one.counts, other.counts)
    assert again.indices() == [0, 3]


def test_a_keyframe_whose_mask_changed_takes_its_place() -> None:
    coverage, frames = covered()
    frames.graph.keyframes[1].hide(None)
    coverage.replace(frames.graph.keyframes[1])
    assert not any((view.depth == 0).any() for view in coverage.views())
    assert torch.equal(frames.graph.keyframes[1].depth > 0, torch.ones(48, 64, dtype=torch.bool))
