"""Which frames become keyframes, which are stored, connected and replayed (Sec. IV-C), worked out by hand before a wall."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from helpers.flat_wall import CAMERA, PAPER, at, keyframe
from idfslam.config import KeyframeConfig
from idfslam.frame import Frame, Status
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph


def graph(config: KeyframeConfig = PAPER, *, places: tuple[float, ...] = ()) -> KeyframeGraph:
    """Keyframes promoted at x = places [m]."""
    made = KeyframeGraph(config, torch.Generator().manual_seed(0))
    for i, x in enumerate(places):
        made.append(i / 30, at(x), Status.OK)
        made.promote(keyframe(i, x))
    return made


@pytest.mark.parametrize(
    ("x", "turn", "status", "asked"),
    [
        (0.14, 0, Status.OK, False),
        (0.16, 0, Status.OK, True),
        (0, 11, Status.OK, False),
        (0, 13, Status.OK, True),
        (0, 0, Status.LOST, True),
    ],
)
def test_motion_or_loss_asks_for_a_keyframe(x: float, turn: float, status: Status, asked: bool) -> None:
    assert graph(places=(0.0,)).asks_for_keyframe(at(x, turn), status) is asked


def test_the_first_frame_is_a_keyframe() -> None:
    assert graph().asks_for_keyframe(at(0), Status.OK)


def test_motion_counts_from_the_last_chosen_frame_even_if_it_was_culled() -> None:
    made = graph(places=(0.0, 0.2))  # the second shares 1 - 4/64 with the first: culled
    assert len(made.keyframes) == 1
    assert not made.asks_for_keyframe(at(0.3), Status.OK)
    assert made.asks_for_keyframe(at(0.36), Status.OK)


@pytest.mark.parametrize(
    ("x", "stored", "connected"),
    [(1.4, False, True), (1.8, True, True), (2.1, True, True), (2.6, True, False)],  # shares 0.56, 0.44, 0.34, 0.19
)
def test_culling_and_covisibility_by_hand(x: float, stored: bool, connected: bool) -> None:
    made = graph(places=(0.0,))
    made.append(1.0, at(x), Status.OK)
    new = keyframe(1, x)
    assert made.promote(new) is stored
    assert new.neighbours == ({0} if connected else set())
    assert made.keyframes[0].neighbours == ({1} if stored and connected else set())


def test_without_culling_all_are_stored() -> None:
    assert len(graph(KeyframeConfig(cull=1.0), places=(0.0, 0.0, 0.1)).keyframes) == 3


def test_a_culled_frame_keeps_its_refined_pose() -> None:
    made = graph(places=(0.0,))
    made.append(1.0, at(0.2), Status.OK)
    refined = keyframe(1, 0.25)
    assert not made.promote(refined)
    torch.testing.assert_close(made.T_wc(-1), at(0.25))


def test_frames_follow_their_keyframe() -> None:
    made = graph(places=(0.0,))
    made.append(1.0, at(0.1), Status.LOST)
    made.keyframes[0].T_wk = at(0.5)
    np.testing.assert_allclose(made.trajectory()[:, 0, 3], [0.5, 0.6])
    assert made.statuses() == [Status.OK, Status.LOST]


def test_replay_draws_only_what_is_not_connected_and_at_most_so_many() -> None:
    # 20 places 1.7 m apart: a share of 0.47 with the next (connected), of -0.06, so none, with the one after.
    made = graph(places=tuple(1.7 * i for i in range(20)))
    assert len(made.keyframes) == 20
    newest = made.keyframes[-1]
    assert newest.neighbours == {18}
    seen = set()
    for _ in range(30):
        drawn = made.replay(newest)
        indices = [k.index for k in drawn]
        assert len(indices) == len(set(indices)) == 10
        assert not {18, 19} & set(indices)
        seen |= set(indices)
    assert seen == set(range(18))
    few = graph(places=(0.0, 1.7, 3.4))
    assert [k.index for k in few.replay(few.keyframes[-1])] == [0]


def test_replay_of_connected_keyframes_is_apart() -> None:
    made = graph(KeyframeConfig(cull=0.5, replay=0, replay_connected=2), places=(0.0, 1.7, 3.4))
    assert [k.index for k in made.replay(made.keyframes[-1])] == [1]


def test_what_a_loop_has_moved_is_replayed_first_and_the_nearest_of_it() -> None:
    made = graph(KeyframeConfig(cull=0.5, replay=1, replay_connected=1), places=(0.0, 1.7, 3.4, 5.1))
    for i in (0, 1, 3):
        made.keyframes[i].unlearnt = 1
    assert [k.index for k in made.replay(made.keyframes[-1])] == [1, 0]  # the newest itself is learnt anyway
    for moved in made.keyframes[:2]:
        moved.unlearnt = 0
    assert sorted(k.index for k in made.replay(made.keyframes[-1])) in ([0, 2], [1, 2])


def test_a_culled_frame_replays_by_its_own_neighbours() -> None:
    made = graph(places=(0.0, 1.7, 3.4))
    made.append(1.0, at(3.5), Status.OK)
    culled = keyframe(3, 3.5)  # shares 0.97 with the last, 0.44 with the one before
    assert not made.promote(culled)
    assert culled.neighbours == {1, 2}
    assert [k.index for k in made.replay(culled)] == [0]


def test_the_tracker_is_given_the_last_keyframe_or_the_one_that_sees_most() -> None:
    # Keyframes at 0, 0.5 and 1.0 m, the camera back at 0.1: 1 - 20 * 0.1 / 64 = 97 % of its view lies in the first, 72 % in the last.
    frame = keyframe(9, 0.1)
    last, covisible = (graph(replace(PAPER, reference=chosen), places=(0, 0.5, 1.0)) for chosen in ("last", "covisible"))
    assert [k.index for k in last.tracking_references(frame)] == [2]
    assert [k.index for k in covisible.tracking_references(frame)] == [0, 2]  # the last one, should the frame be lost against the first
    assert [k.index for k in covisible.tracking_references(keyframe(9, 0.9))] == [2]
    blank = Keyframe(Frame.blank(9, 0.3, CAMERA), at(0.1), torch.zeros(48, 64), torch.zeros(48, 64, 3))
    assert covisible.tracking_references(blank) == [covisible.reference]
    assert graph(replace(PAPER, reference="covisible")).tracking_references(frame) == []
