"""A relocalisation is undone where the images of old keyframes contradict it, and stands where they go on agreeing."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from helpers.flat_wall import PAPER, at, insert, keyframe, wall_frames
from idfslam.config import FAST
from idfslam.frame import Status
from idfslam.geometry import se3
from idfslam.graph.frame_poses import FramePoses
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_selection import KeyframeSelection
from idfslam.graph.loop_consistency import Loop, LoopConsistency
from idfslam.slam.place_recognition.relocalisation_check import RelocalisationCheck

DOUBTFUL = 0.03  # photometric error


class Witness:
    """An aligner with a given answer to each comparison: share of landmarks in view, photometric error."""

    usual_error = SimpleNamespace(doubtful=DOUBTFUL)

    def __init__(self) -> None:
        self.answer: tuple[float, float] = 0.8, 0.01

    def photometric_comparison(self, view: Keyframe, reference: Keyframe, T_wc: torch.Tensor) -> tuple[float, float]:
        return self.answer


def found_again(places: tuple[float, ...] = (0.0, 0.8)) -> FramePoses:
    """Three keyframes at 0 to 1.6 m before a wall, two lost frames, and the camera found beside the first; then keyframes at `places`."""
    config = replace(PAPER, cull=0.9)
    frames = wall_frames(config, places=(0.0, 0.8, 1.6), verify=True)
    graph, selection = frames.graph, KeyframeSelection(config, frames.graph, frames, lost_frames=False)
    for i in (3, 4):
        frames.append(i / 30, at(1.6), Status.LOST)
    for i, x in enumerate(places, start=5):
        view = keyframe(i, x)
        if i == 5:
            graph.attach(view, graph.keyframes[0])
        frames.append(i / 30, at(x), Status.OK)
        if i == 5:
            frames.interpolate_gaps()
        assert selection.selects(view, Status.OK)
        assert graph.insert(view)
        frames.attach_last(view)
    return frames


def test_what_comes_after_is_kept_apart_from_what_was_stored_before() -> None:
    graph = found_again().graph  # the same views as before, and stored all the same
    assert len(graph.keyframes) == 5
    assert graph.unverified_from == 3
    assert {i for k in graph.keyframes[3:] for i in k.covisible} >= {0, 1}


def test_what_was_mapped_at_a_wrong_place_becomes_a_submap() -> None:
    frames = found_again()
    graph = frames.graph
    between = se3.inverse(graph.keyframes[3].T_wk) @ graph.keyframes[4].T_wk
    assert frames.statuses()[3:5] == [Status.INTERPOLATED] * 2
    seemingly_covisible = graph.split_off()
    frames.undo_interpolation_before(3)
    assert graph.unverified_from is None
    assert seemingly_covisible
    assert all(k.host < 3 for k in seemingly_covisible)
    assert [k.submap for k in graph.keyframes] == [0, 0, 0, 3, 3]
    torch.testing.assert_close(se3.inverse(graph.keyframes[3].T_wk) @ graph.keyframes[4].T_wk, between)
    assert float(graph.keyframes[3].T_wk[0, 3]) > 90
    for k in graph.keyframes:
        assert all((i < 3) == (k.host < 3) for i in [*k.covisible, *k.edges, *k.covisible_references, *k.unverified])
    assert frames.statuses() == [Status.OK] * 3 + [Status.LOST] * 4
    assert np.abs(frames.trajectory()[:, :3, 3]).max() < 2
    assert [frames.submap(i) for i in range(len(frames))] == [0] * 5 + [3] * 2


def test_another_submap_or_a_merge_ends_the_check() -> None:
    frames = found_again()
    graph = frames.graph
    T_wc = graph.start_submap()
    assert graph.unverified_from is None
    assert insert(frames, keyframe(7, float(T_wc[0, 3])))
    graph.unverified_from = 5
    graph.merge_submaps(0, 5, at(0.5))
    assert graph.unverified_from is None
    assert {k.submap for k in graph.keyframes} == {0}


def test_loops_with_what_was_split_off_are_forgotten() -> None:
    graph, loops = found_again().graph, LoopConsistency(FAST.loops)
    loops.closed = [Loop(0, 2, at(1.6), 2), Loop(0, 4, at(0.8), 6)]
    loops.waiting = Loop(1, 3, at(0.1), 5)
    graph.split_off()
    loops.forget_between(graph)
    assert [(loop.a, loop.b) for loop in loops.closed] == [(0, 2)]
    assert loops.waiting is None


def begun(frames: FramePoses, witness: Witness) -> RelocalisationCheck:
    check = RelocalisationCheck(witness, frames.graph, frames)  # type: ignore[arg-type]
    check.begin()
    return check


@pytest.mark.parametrize(
    ("answers", "verdicts"),
    [
        ([(0.8, 0.01)] * 3, [False] * 3),
        ([(0.8, 0.05)] * 3, [False, True, True]),
        ([(0.8, 0.05), (0.8, 0.01), (0.8, 0.05)], [False] * 3),  # not in a row
        ([(0.2, 0.05)] * 3, [False] * 3),  # out of view says nothing
        ([(0.8, 0.041)] * 3, [False] * 3),  # worse than usual, but no contradiction
    ],
)
def test_two_keyframes_in_a_row_must_be_contradicted(answers: list[tuple[float, float]], verdicts: list[bool]) -> None:
    frames, witness = found_again(), Witness()
    check, contradicted = begun(frames, witness), []
    for witness.answer in answers:
        contradicted.append(check.contradicted(frames.graph.keyframes[4]))
    assert contradicted == verdicts
    assert check.refuted == check.figures()["relocalisations_refuted"] == sum(verdicts)


def test_a_refuted_place_is_split_off_and_learnt_again() -> None:
    frames, witness = found_again(), Witness()
    check, last = begun(frames, witness), frames.graph.keyframes[4]
    witness.answer = 0.8, 0.05
    nothing = check.on_keyframe(last)
    assert (nothing.keyframes, nothing.submap, nothing.split) == ((), False, False)
    moved = check.on_keyframe(last)
    assert moved.submap and moved.split
    assert [k.submap for k in frames.graph.keyframes] == [0, 0, 0, 3, 3]
    assert {k.index for k in moved.keyframes} >= {5, 6} and {k.index for k in moved.keyframes} & {0, 1, 2}
    assert frames.statuses() == [Status.OK] * 3 + [Status.LOST] * 4


def test_the_check_ends_where_a_keyframe_agrees_far_from_where_it_began() -> None:
    frames = found_again()
    graph, check = frames.graph, begun(frames, Witness())
    assert not check.contradicted(graph.keyframes[4])
    assert graph.unverified_from == 3
    graph.keyframes[4].T_wk = at(0.8, 90)  # as far as 3.1 m
    assert not check.contradicted(graph.keyframes[4])
    assert graph.unverified_from is None


def test_state() -> None:
    frames, witness = found_again(), Witness()
    check = begun(frames, witness)
    witness.answer = 0.8, 0.05
    check.contradicted(frames.graph.keyframes[4])
    again = RelocalisationCheck(witness, frames.graph, frames)  # type: ignore[arg-type]
    again.restore(check.state())
    assert again.contradicted(frames.graph.keyframes[4])
