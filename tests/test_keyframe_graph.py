"""Which keyframes are stored, connected and compared with (Sec. IV-C), worked out by hand before a wall."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from helpers.flat_wall import CAMERA, PAPER, at, insert, keyframe, wall_frames, wall_graph
from idfslam.config import KeyframeConfig
from idfslam.frame import Frame
from idfslam.graph.keyframe import Keyframe


@pytest.mark.parametrize(
    ("x", "stored", "connected"),
    [(1.4, False, True), (1.8, True, True), (2.1, True, True), (2.6, True, False)],  # shares 0.56, 0.44, 0.34, 0.19
)
def test_culling_and_covisibility_by_hand(x: float, stored: bool, connected: bool) -> None:
    frames, new = wall_frames(places=(0.0,)), keyframe(1, x)
    assert insert(frames, new) is stored
    assert new.covisible == ({0} if connected else set())
    assert frames.graph.keyframes[0].covisible == ({1} if stored and connected else set())


def test_without_culling_all_are_stored() -> None:
    assert len(wall_graph(KeyframeConfig(cull=1.0), places=(0.0, 0.0, 0.1)).keyframes) == 3


@pytest.mark.parametrize(("hidden", "stored"), [(20, False), (36, True)])  # of 64 columns; shares 0.94 - 20 / 64 = 0.62, and 0.38
def test_a_keyframe_covers_nothing_that_moving_things_hid_in_it(hidden: int, stored: bool) -> None:
    frames, moving = wall_frames(places=(0.0,)), np.zeros((48, 64), bool)
    moving[:, :hidden] = True
    frames.graph.keyframes[0].hide(moving)
    assert insert(frames, keyframe(1, -0.2)) is stored


def test_a_culled_frame_is_the_last_keyframe_and_hangs_on_the_one_that_covers_it() -> None:
    frames, culled = wall_frames(places=(0.0,)), keyframe(1, 0.2)
    assert not insert(frames, culled)
    assert frames.graph.last_keyframe is culled
    assert culled.host == 0


def test_the_tracker_is_given_the_last_keyframe_or_the_one_that_sees_most() -> None:
    # Keyframes at 0, 0.5 and 1.0 m, the camera back at 0.1: 1 - 20 * 0.1 / 64 = 97 % of its view lies in the first, 72 % in the last.
    frame = keyframe(9, 0.1)
    last, covisible = (wall_graph(replace(PAPER, reference=chosen), places=(0, 0.5, 1.0)) for chosen in ("last", "covisible"))
    assert [k.index for k in last.tracking_references(frame)] == [2]
    assert [k.index for k in covisible.tracking_references(frame)] == [0, 2]  # the last one, should the frame be lost against the first
    assert [k.index for k in covisible.tracking_references(keyframe(9, 0.9))] == [2]
    blank = Keyframe(Frame.blank(9, 0.3, CAMERA), at(0.1), torch.zeros(48, 64), torch.zeros(48, 64, 3))
    assert covisible.tracking_references(blank) == [covisible.last_keyframe]
    assert wall_graph(replace(PAPER, reference="covisible")).tracking_references(frame) == []
