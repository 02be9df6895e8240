"""A place that was found by its looks is given up where old keyframes contradict it, and stands where they go on agreeing."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from helpers.flat_wall import PAPER, at, keyframe
from idfslam.config import FAST
from idfslam.frame import Status
from idfslam.geometry import se3
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.graph.loop_consistency import Loop, Loops
from idfslam.slam.relocalisation_check import Trial
from idfslam.storage.state import State

USUAL = 0.03  # doubtful difference of brightness


class Witness:
    """An aligner whose comparisons are told beforehand: share of landmarks in view, difference of brightness."""

    doubtful_brightness = USUAL

    def __init__(self) -> None:
        self.told: tuple[float, float] = 0.8, 0.01

    def compare(self, view: Keyframe, reference: Keyframe, T_wc: torch.Tensor) -> tuple[float, float]:
        return self.told


def found_again(places: tuple[float, ...] = (0.0, 0.8)) -> KeyframeGraph:
    """Three keyframes at 0 to 1.6 m before a wall, two lost frames, and the camera found beside the first; then keyframes at `places`."""
    graph = KeyframeGraph(replace(PAPER, cull=0.9), torch.Generator().manual_seed(0), verify=True)
    for i, x in enumerate((0.0, 0.8, 1.6)):
        graph.append(i / 30, at(x), Status.OK)
        graph.promote(keyframe(i, x))
    for i in (3, 4):
        graph.append(i / 30, at(1.6), Status.LOST)
    for i, x in enumerate(places, start=5):
        if i == 5:
            graph.settle(keyframe(i, x), graph.keyframes[0])
        graph.append(i / 30, at(x), Status.OK)
        if i == 5:
            graph.bridge()
        assert graph.asks_for_keyframe(at(x), Status.OK)
        assert graph.promote(keyframe(i, x))
    return graph


def test_what_comes_after_is_kept_apart_from_what_was_known() -> None:
    graph = found_again()  # the same views as before, and stored all the same
    assert len(graph.keyframes) == 5
    assert graph.trial == 3
    assert {i for k in graph.keyframes[3:] for i in k.neighbours} >= {0, 1}


def test_a_place_given_up_becomes_a_piece() -> None:
    graph = found_again()
    between = se3.inverse(graph.keyframes[3].T_wk) @ graph.keyframes[4].T_wk
    assert graph.statuses()[3:5] == [Status.INTERPOLATED] * 2
    beside = graph.cut()
    assert graph.trial is None
    assert beside
    assert all(k.anchor < 3 for k in beside)
    assert [k.piece for k in graph.keyframes] == [0, 0, 0, 3, 3]
    torch.testing.assert_close(se3.inverse(graph.keyframes[3].T_wk) @ graph.keyframes[4].T_wk, between)
    assert float(graph.keyframes[3].T_wk[0, 3]) > 90
    for k in graph.keyframes:
        assert all((i < 3) == (k.anchor < 3) for i in [*k.neighbours, *k.linked, *k.alike, *k.unlinked])
    assert graph.statuses() == [Status.OK] * 3 + [Status.LOST] * 4
    assert np.abs(graph.trajectory()[:, :3, 3]).max() < 2
    assert [graph.piece(i) for i in range(len(graph))] == [0] * 5 + [3] * 2


def test_another_piece_or_a_meeting_ends_the_trial() -> None:
    graph = found_again()
    T_wc = graph.begin_piece()
    assert graph.trial is None
    graph.append(7 / 30, T_wc, Status.OK)
    new = keyframe(7, float(T_wc[0, 3]))
    assert graph.promote(new)
    graph.trial = 5
    graph.join(0, 5, at(0.5))
    assert graph.trial is None
    assert {k.piece for k in graph.keyframes} == {0}


def test_loops_across_the_cut_are_forgotten() -> None:
    graph, loops = found_again(), Loops(FAST.loops)
    loops.closed = [Loop(0, 2, at(1.6), 2), Loop(0, 4, at(0.8), 6)]
    loops.waiting = Loop(1, 3, at(0.1), 5)
    graph.cut()
    loops.forget_between(graph)
    assert [(loop.a, loop.b) for loop in loops.closed] == [(0, 2)]
    assert loops.waiting is None


def judged(graph: KeyframeGraph, witness: Any) -> Trial:
    trial = Trial(witness, graph)
    trial.begin()
    return trial


@pytest.mark.parametrize(
    ("told", "verdicts"),
    [
        ([(0.8, 0.01)] * 3, [False] * 3),
        ([(0.8, 0.05)] * 3, [False, True, True]),
        ([(0.8, 0.05), (0.8, 0.01), (0.8, 0.05)], [False] * 3),  # not in a row
        ([(0.2, 0.05)] * 3, [False] * 3),  # out of view says nothing
        ([(0.8, 0.041)] * 3, [False] * 3),  # worse than usual, but no contradiction
    ],
)
def test_two_keyframes_in_a_row_must_be_contradicted(told: list[tuple[float, float]], verdicts: list[bool]) -> None:
    graph, witness = found_again(), Witness()
    trial, found = judged(graph, witness), []
    for witness.told in told:
        found.append(trial.refutes(graph.keyframes[4]))
    assert found == verdicts
    assert trial.refuted == sum(verdicts)


def test_the_trial_ends_where_a_keyframe_agrees_far_from_where_it_began() -> None:
    graph = found_again()
    trial = judged(graph, Witness())
    assert not trial.refutes(graph.keyframes[4])
    assert graph.trial == 3
    graph.keyframes[4].T_wk = at(0.8, 90)  # as far as 3.1 m
    assert not trial.refutes(graph.keyframes[4])
    assert graph.trial is None


def test_state() -> None:
    graph, witness = found_again(), Witness()
    trial = judged(graph, witness)
    witness.told = 0.8, 0.05
    trial.refutes(graph.keyframes[4])
    again = Trial(witness, graph)  # type: ignore[arg-type]
    state: State = trial.state()
    again.restore(state)
    assert again.refutes(graph.keyframes[4])
