"""Which frames become keyframes (Sec. III), worked out by hand before a wall."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from helpers.flat_wall import CAMERA, PAPER, at, keyframe, wall_frames
from idfslam.frame import Frame, Status
from idfslam.graph.frame_poses import FramePoses
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_selection import KeyframeSelection


def selection(frames: FramePoses, *, lost_frames: bool = True) -> KeyframeSelection:
    return KeyframeSelection(PAPER, frames.graph, frames, lost_frames=lost_frames)


def moved_to(T_wc: Tensor) -> Keyframe:
    view = keyframe(9, 0.0)
    view.T_wk = T_wc
    return view


MOTIONS = [
    (0.14, 0, Status.OK, False),
    (0.16, 0, Status.OK, True),
    (0, 11, Status.OK, False),
    (0, 13, Status.OK, True),
    (0, 0, Status.LOST, True),
]


@pytest.mark.parametrize(("x", "turn", "status", "selected"), MOTIONS)
def test_motion_or_loss_selects_a_keyframe(x: float, turn: float, status: Status, selected: bool) -> None:
    assert selection(wall_frames(places=(0.0,))).selects(moved_to(at(x, turn)), status) is selected


def test_the_first_frame_is_a_keyframe() -> None:
    assert selection(wall_frames()).selects(moved_to(at(0)), Status.OK)


def test_motion_counts_from_the_last_selected_frame_even_if_it_was_culled() -> None:
    frames = wall_frames(places=(0.0, 0.2))  # the second shares 1 - 4/64 with the first: culled
    assert len(frames.graph.keyframes) == 1
    assert not selection(frames).selects(moved_to(at(0.3)), Status.OK)
    assert selection(frames).selects(moved_to(at(0.36)), Status.OK)


def test_lost_frames_are_none_where_the_camera_is_looked_for() -> None:
    assert not selection(wall_frames(places=(0.0,)), lost_frames=False).selects(moved_to(at(0)), Status.LOST)


def test_never_without_depth() -> None:
    blank = Keyframe(Frame.blank(9, 0.3, CAMERA), at(9.0), torch.zeros(48, 64), torch.zeros(48, 64, 3))
    assert not selection(wall_frames(places=(0.0,))).selects(blank, Status.OK)


def test_a_view_that_loses_sight_of_its_references_is_selected_but_not_each_of_a_row() -> None:
    frames = wall_frames(places=(0.0,))
    config = replace(PAPER, in_view=0.5, in_view_every=2)
    chosen, selected = KeyframeSelection(config, frames.graph, frames, lost_frames=True), []
    for i in range(1, 8):
        view = keyframe(i, 0.01)
        frames.append(view.timestamp, view.T_wk, Status.OK)
        selected.append(chosen.selects(view, Status.OK, in_view=0.4))
    assert selected == [False, True, False, False, True, False, False]  # 3 frames after the last selected one at the earliest
    assert chosen.state() == {"last_at": 6}
    again = selection(frames)
    again.restore(chosen.state())
    assert again.state() == chosen.state()
