"""Frames whose pose is in doubt: reported with a status and a covariance, and never mapped. The front end is one that knows the truth."""

from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from helpers.flat_wall import PAPER, at, keyframe, wall_frames
from helpers.small_config import small
from idfslam.datasets import open_recording
from idfslam.frame import FrameResult, Status
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_selection import KeyframeSelection
from idfslam.slam import FrontEnd, Slam, Source, Tracked

COVARIANCE = torch.diag(torch.tensor([1e-4, 4e-4, 4e-4, 1e-5, 2e-5, 3e-5], dtype=torch.float64))


class Knowing(FrontEnd):
    """It tells the true poses, and its doubt at the frames that it is told."""

    def __init__(self, truth: np.ndarray, doubtful: Collection[int]) -> None:
        self.T_wc, self.doubtful = torch.from_numpy(np.linalg.inv(truth[0]) @ truth), doubtful

    def track(self, view: Keyframe) -> Tracked:
        status = Status.DOUBTFUL if view.index in self.doubtful else Status.OK
        return Tracked(self.T_wc[view.index].clone(), status, Source.REGISTERED, covariance=COVARIANCE)


def run(recording: Path, doubtful: Collection[int]) -> tuple[Slam, list[FrameResult], set[int]]:
    """The box room of 14 frames, a map update after every second frame; with the frames that the map was trained on."""
    data, config = open_recording(recording), small()
    config = replace(config, mapper=replace(config.mapper, every=2))
    slam, mapped = Slam(config, front_end=lambda system: Knowing(np.asarray(data.ground_truth), doubtful)), set[int]()
    learn, start = slam.mapper.optimise_map, slam.mapper.start_update

    def watched(call):
        def wrapper(window, *arguments, **options):
            mapped.update(view.index for view in window)
            return call(window, *arguments, **options)

        return wrapper

    slam.mapper.optimise_map, slam.mapper.start_update = watched(learn), watched(start)
    results = [slam.process(data[i]) for i in range(len(data))]
    slam.finish()
    return slam, results, mapped


def test_a_frame_in_doubt_is_never_mapped(box_recording: Path) -> None:
    slam, results, mapped = run(box_recording, doubtful=range(6, 14))
    assert [result.status for result in results] == [Status.OK] * 6 + [Status.DOUBTFUL] * 8 == slam.statuses()
    assert not any(result.keyframe for result in results[6:])
    assert {k.index for k in slam.stored_keyframes()} | mapped <= set(range(6)) and 5 in mapped  # `finish` maps no last frame
    _, _, without_doubt = run(box_recording, doubtful=())
    assert 13 in without_doubt and len(without_doubt & set(range(6, 13))) >= 3


def test_the_covariance_is_reported(box_recording: Path) -> None:
    slam, results, _ = run(box_recording, doubtful=(6,))
    assert results[0].covariance is None  # the first frame defines the world
    for result in results[1:]:
        assert result.covariance is not None and np.array_equal(result.covariance, COVARIANCE.numpy())
    assert results[1].covariance is not results[2].covariance
    np.testing.assert_allclose(slam.trajectory()[6], results[6].T_wc, atol=0.02)  # its pose is kept


@pytest.mark.parametrize("covariance", [COVARIANCE, None])
def test_the_state_of_a_tracked_frame_holds_it(covariance: torch.Tensor | None) -> None:
    tracked = Tracked(torch.eye(4, dtype=torch.float64), Status.DOUBTFUL, Source.ALIGNED, covariance=covariance)
    again = Tracked.from_state(tracked.state())
    assert (again.status, again.covariance is covariance, again.is_lost) == (Status.DOUBTFUL, True, False)
    assert tracked.lost(tracked.T_wc).covariance is None


def test_it_is_no_keyframe_however_far_it_moved() -> None:
    frames = wall_frames(places=(0.0,))
    view = keyframe(9, 0.0)
    view.T_wk = at(0.9)
    selection = KeyframeSelection(PAPER, frames.graph, frames, lost_frames=True)
    assert not selection.selects(view, Status.DOUBTFUL, in_view=0.1)
    assert selection.selects(view, Status.OK)


def test_which_statuses_are_trusted() -> None:
    assert [status for status in Status if status.trusted] == [Status.OK, Status.DEGENERATE]
    assert [status for status in Status if status.measured] == [Status.OK, Status.DEGENERATE, Status.DOUBTFUL]
