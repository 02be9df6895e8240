"""Keyframes by information gain and at an interval."""

from dataclasses import replace

import pytest
import torch

from helpers.flat_wall import PAPER, keyframe, wall_frames
from idfslam.frame import Status
from idfslam.graph.information_gain import InformationGain
from idfslam.graph.keyframe_interval import KeyframeInterval
from idfslam.mapping.joint.joint_map import explained_share


def test_the_share_that_a_map_explains() -> None:
    # errors of 5 %, 9.9 %, 10.1 % and 50 %, and one pixel without a reading: two of four
    measured = torch.tensor([2.0, 1.0, 1.0, 4.0, 0.0])
    rendered = torch.tensor([2.1, 1.099, 0.899, 2.0, 1.0])
    assert explained_share(rendered, measured, 0.1) == 0.5
    assert explained_share(rendered, torch.zeros(5), 0.1) == 1.0


@pytest.mark.parametrize(("explained", "selected"), [(0.64, True), (0.65, False), (1.0, False)])
def test_a_frame_becomes_a_keyframe_where_the_map_explains_too_little(explained: float, selected: bool) -> None:
    frames = wall_frames(places=(0.0,))
    selection = InformationGain(replace(PAPER, least_sharpness=0), frames.graph, frames, lambda view: explained, lost_frames=True)
    assert selection.selects(keyframe(1, 0.0), Status.OK) is selected


def test_the_first_frame_always_does() -> None:
    frames = wall_frames()
    selection = InformationGain(replace(PAPER, least_sharpness=0), frames.graph, frames, lambda view: 1.0, lost_frames=True)
    assert selection.selects(keyframe(0, 0.0), Status.OK)


def test_keyframes_at_an_interval() -> None:
    frames = wall_frames(places=(0.0,))
    selection = KeyframeInterval(replace(PAPER, interval=3, least_sharpness=0), frames.graph, frames, lost_frames=True)
    assert [i for i in range(1, 10) if selection.selects(keyframe(i, 5.0 * i), Status.OK)] == [3, 6, 9]
