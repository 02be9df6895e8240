"""Which keyframes have a frame's surroundings in sight, and the windows that are drawn from them."""

import pytest
import torch

from helpers.flat_wall import at, keyframe, wall_graph
from idfslam.config import JointMappingConfig
from idfslam.graph.ray_overlap import in_sight, ray_overlap
from idfslam.slam.back_end.mapping_window import LossWindow, OverlapWindow


def generator() -> torch.Generator:
    return torch.Generator().manual_seed(0)


def test_points_in_sight() -> None:
    # A camera of 64 x 48 px has a border of 12: 40 columns and 24 rows count. At 2 m with f = 40 the middle lies at pixel (31.5, 23.5).
    points = torch.tensor([[0.0, 0, 2], [0.9, 0, 2], [1.1, 0, 2], [0, 0, -2]], dtype=torch.float64)
    assert in_sight(keyframe(0, 0.0), points) == 0.5  # 31.5 + 20 * 0.9 = 49.5 < 52; 31.5 + 22 = 53.5 is beyond; behind the camera
    moved = keyframe(0, 0.0)
    moved.T_wk = at(2.0)
    assert in_sight(moved, points) == 0.25  # -1.1 m to the side: 31.5 - 22 = 9.5 is beyond, 2 - 1.1 = 0.9 m: 13.5 is in sight


def test_overlap_falls_with_distance() -> None:
    view, others = keyframe(0, 0.0), [keyframe(1, 0.0), keyframe(2, 0.8), keyframe(3, 9.0)]
    near, farther, beyond = ray_overlap(view, others, generator())
    assert near > farther > 0
    assert beyond == 0


def test_a_window_by_overlap() -> None:
    graph = wall_graph(places=(0.0, 2.0, 4.0, 90.0, 92.0))
    window = OverlapWindow(JointMappingConfig(window=5, choice="overlap"), graph, generator())
    view = keyframe(9, 90.1)
    drawn = window.around(view)()
    assert [k.index for k in drawn[-2:]] == [4, 9]  # the last keyframe and the view
    assert [k.index for k in drawn[:-2]] == [3]  # the others see nothing of it
    assert window.around(view)() == drawn  # one choice for an update


def test_a_window_by_loss() -> None:
    graph = wall_graph(places=(0.0, 2.0, 4.0, 6.0, 8.0, 10.0))
    losses = {0: 0.0, 1: 1.0, 2: 2.0, 3: 1.0, 4: 0.0}
    window = LossWindow(JointMappingConfig(window=3, choice="loss"), graph, generator(), lambda k: losses.get(k.index, 9.0))
    draw, counts = window.around(keyframe(9, 0.0)), dict.fromkeys(range(6), 0)
    for _ in range(400):
        chosen, last, view = draw()
        assert (last.index, view.index) == (5, 9)
        counts[chosen.index] += 1
    assert counts[0] == counts[4] == counts[5] == 0
    assert counts[2] == pytest.approx(200, abs=40)  # half of the loss; 4 standard deviations of 10
    assert counts[1] == pytest.approx(100, abs=35)


def test_a_small_graph_is_a_small_window() -> None:
    window = LossWindow(JointMappingConfig(window=5), wall_graph(), generator(), lambda k: 1.0)
    view = keyframe(0, 0.0)
    assert window.around(view)() == [view]
