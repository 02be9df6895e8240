"""Which frames become keyframes (Sec. III), worked out by hand before a wall."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from torch import Tensor

from helpers.flat_wall import CAMERA, PAPER, at, keyframe, wall_frames
from idfslam.frame import Frame, Status
from idfslam.graph.frame_poses import FramePoses
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_selection import KeyframeSelection
from idfslam.sensing.sharpness import Sharpness, sharpness


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
    assert chosen.state() == {"last_at": 6, "put_off": 0}
    again = selection(frames)
    again.restore(chosen.state())
    assert again.state() == chosen.state()


def textured(index: int, x: float, width: int = 1) -> Keyframe:
    """A view of a wall of random colours, blurred over so many columns by a sideways motion."""
    sharp = np.random.default_rng(0).random((48, 64, 3), np.float32)
    colour = np.ascontiguousarray(cv2.blur(sharp, (width, 1)))
    depth = np.full((48, 64), 2, np.float32)
    return Keyframe(Frame(index, index / 30, colour, depth, CAMERA), at(x), torch.from_numpy(depth), torch.from_numpy(colour))


def selected_of(widths: list[int], *, in_view: float = 1.0, least_sharpness: float = 0.75) -> list[int]:
    """Indices of the keyframes among frames 5 cm apart, blurred over so many columns each, after nine sharp ones at rest."""
    frames = wall_frames(places=(0.0,))
    config = replace(PAPER, least_sharpness=least_sharpness)
    chosen, found = KeyframeSelection(config, frames.graph, frames, lost_frames=True), list[int]()
    for i, width in enumerate([1] * 9 + widths, -8):
        view = textured(i + 9, 0.051 * max(i, 0), width)
        frames.append(view.timestamp, view.T_wk, Status.OK)
        if chosen.selects(view, Status.OK, in_view):
            found.append(i)
            frames.graph.insert(view)
    return found


def test_a_blurred_keyframe_is_put_off_until_a_frame_is_sharp() -> None:
    assert selected_of([1, 1, 1, 1, 1]) == [3]
    assert selected_of([1, 1, 7, 7, 1]) == [5]
    assert selected_of([1, 1, 7, 7, 1], least_sharpness=0) == [3]


def test_it_is_put_off_for_five_frames_at_most_and_never_where_too_little_is_in_view() -> None:
    assert selected_of([1, 1, 3, 5, 9, 13, 17, 25]) == [8]
    assert selected_of([1, 1, 3, 7, 7, 1], in_view=0.39, least_sharpness=0.75)[0] < 3


def test_sharpness_falls_with_the_width_of_blur_and_not_with_exposure() -> None:
    found = [sharpness(textured(0, 0.0, width).frame.colour) for width in (1, 3, 5, 9)]
    assert found == sorted(found, reverse=True)
    assert found[1] < 0.75 * found[0]
    assert sharpness(0.5 * textured(0, 0.0).frame.colour) == pytest.approx(found[0], rel=0.02)  # but for the noise that is allowed for


def test_each_frame_is_compared_with_those_before_it_and_the_state_is_kept() -> None:
    one = Sharpness()
    assert one.of_next(textured(0, 0.0).frame.colour) == 1.0
    assert one.of_next(textured(1, 0.0).frame.colour) == pytest.approx(1.0)
    other = Sharpness()
    other.restore(one.state())
    blurred = textured(2, 0.0, 7).frame.colour
    assert one.of_next(blurred) == other.of_next(blurred) < 0.5
    assert one.of_next(np.zeros((48, 64, 3), np.float32)) < 0.75
    assert Sharpness().of_next(np.zeros((48, 64, 3), np.float32)) == 1.0
