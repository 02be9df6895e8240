"""Frames whose pose is in doubt: reported with a status and a covariance, and never mapped. The front end is one that knows the truth."""

import json
import re
import shutil
from collections.abc import Collection
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from rich.console import Console

from helpers.box_room import BOX_FRAMES
from helpers.flat_wall import PAPER, at, keyframe, wall_frames
from helpers.known_run import known_log
from helpers.small_config import small
from idfslam.alignment.alignment import Alignment
from idfslam.cli.tables import print_evaluation, print_run
from idfslam.config import FAST
from idfslam.datasets import open_recording
from idfslam.evaluation.doubt import DoubtRates
from idfslam.evaluation.evaluate import evaluate_poses
from idfslam.frame import FrameResult, Status
from idfslam.geometry.trajectory import load_tum, save_tum
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_selection import KeyframeSelection
from idfslam.runs.evaluate_run import evaluate_folder
from idfslam.runs.finished_run import FinishedRun
from idfslam.runs.lost_frames import leave_out_lost
from idfslam.runs.progress import ProgressBar
from idfslam.runs.runner import run as run_recording
from idfslam.slam import FrontEnd, Slam, Source, Tracked
from idfslam.slam.front_end.alignment_to_map import AlignmentToMap
from idfslam.slam.front_end.registered_pose import RegisteredPose
from idfslam.tracking.tracker import TrackingResult

COVARIANCE = torch.diag(torch.tensor([1e-4, 4e-4, 4e-4, 1e-5, 2e-5, 3e-5], dtype=torch.float64))


class Knowing(FrontEnd):
    """It tells the true poses, and its doubt at the frames that it is told."""

    def __init__(self, truth: np.ndarray, doubtful: Collection[int]) -> None:
        self.T_wc, self.doubtful = torch.from_numpy(np.linalg.inv(truth[0]) @ truth), doubtful

    def track(self, view: Keyframe) -> Tracked:
        status = Status.DOUBTFUL if view.index in self.doubtful else Status.OK
        return Tracked(self.T_wc[view.index].clone(), status, Source.REGISTERED, covariance=COVARIANCE)


class Refuting:
    """Patches that no other pose keeps."""

    def agree(self, T_kc: torch.Tensor, T_by_image: torch.Tensor) -> bool:
        return False


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


@pytest.mark.parametrize(
    ("displaced", "in_view", "patches", "sigma", "ends"),
    [
        (1.1, 0.4, 0, 0.003, True),
        (1.1, 0.2, 0, 0.003, False),  # few landmarks are in view
        (0.0, 0.4, 0, 0.003, False),  # none of them tells anything
        (0.0, 0.02, 40, 0.003, True),  # the tracker agrees
        (0.0, 0.02, 40, 0.1, False),  # it is not sure itself: its patches lie in a strip of the image
        (2.6, 0.4, 40, 0.1, False),  # likewise, and the image contradicts
        (2.6, 0.4, 40, 0.003, True),  # landmarks of something that has moved contradict
    ],
)
def test_a_doubt_ends_where_keyframes_confirm_the_pose(displaced: float, in_view: float, patches: int, sigma: float, ends: bool) -> None:
    """displaced: the image, over what is usual. patches, sigma: of a registration that agrees; the error [m] that is expected of it."""
    front_end = Slam(FAST).front_end
    assert isinstance(front_end, AlignmentToMap)
    front_end.aligner.doubt.expect([0.01])
    T_wc = at(0.1, 0)
    found = Alignment(T_wc, Status.OK, 1.0, 0.001, 0.1, 0.01, in_view, None, 5, displacement=0.01 * displaced)
    covariance = np.diag([sigma**2, 0, 0, 0, 0, 0])
    result = TrackingResult(T_wc.numpy(), Status.OK, 100, 50, 0.01, covariance, patches)
    front_end._begin = lambda view: None  # type: ignore[method-assign]
    front_end.search.best = lambda view, motion: (found, RegisteredPose(keyframe(0, 0.0), result))  # type: ignore[method-assign]
    statuses = []
    for before in (Status.OK, Status.DOUBTFUL):
        front_end.frames.append(0.0, T_wc, before)
        statuses.append(front_end.track(keyframe(2, 0.1)).status)
    doubted = displaced > 2.5 and not ends
    assert statuses == [Status.DOUBTFUL if doubted else Status.OK, Status.OK if ends else Status.DOUBTFUL]


@pytest.mark.parametrize(
    ("sigma", "displaced", "in_view", "patches", "doubtful"),
    [
        (0.04, 0.0, 1.0, 0, True),  # the keyframes have no landmarks
        (0.04, 1.1, 0.2, 0, True),  # few of them are in view
        (0.04, 1.1, 0.4, 0, False),  # the image agrees
        (0.04, 0.0, 1.0, 40, False),  # the tracker agrees
        (0.02, 0.0, 1.0, 0, False),  # depth measures the pose
    ],
)
def test_a_pose_that_nothing_measures_is_in_doubt(sigma: float, displaced: float, in_view: float, patches: int, doubtful: bool) -> None:
    """sigma: standard deviation along each of three axes [m]. The others as above."""
    front_end = Slam(FAST).front_end
    assert isinstance(front_end, AlignmentToMap)
    front_end.aligner.doubt.expect([0.01])
    T_wc, covariance = at(0.1, 0), torch.diag(torch.tensor([sigma**2] * 3 + [1e-6] * 3, dtype=torch.float64))
    found = Alignment(T_wc, Status.DEGENERATE, 1.0, 0.001, 0.1, 0.01, in_view, None, 5, covariance, displacement=0.01 * displaced)
    result = TrackingResult(T_wc.numpy(), Status.OK, 100, 50, 0.01, 1e-6 * np.eye(6), patches)
    front_end._begin = lambda view: None  # type: ignore[method-assign]
    front_end.search.best = lambda view, motion: (found, RegisteredPose(keyframe(0, 0.0), result))  # type: ignore[method-assign]
    front_end.frames.append(0.0, T_wc, Status.OK)
    assert front_end.track(keyframe(2, 0.1)).status is (Status.DOUBTFUL if doubtful else Status.DEGENERATE)


@pytest.mark.parametrize(
    ("away", "sigma", "doubtful"),
    [
        (0.06, 0.03, True),  # few patches in a strip of the image lead far away
        (0.06, 0.02, False),  # they fix the pose
        (0.04, 0.03, False),  # both poses are about the same
    ],
)
def test_a_registered_pose_far_from_the_aligned_one_has_to_be_sure(away: float, sigma: float, doubtful: bool) -> None:
    """away: between the two poses [m]; the image refutes the aligned one. sigma: the error [m] expected of the registered one."""
    front_end = Slam(FAST).front_end
    assert isinstance(front_end, AlignmentToMap)
    T_wc = at(0.1, 0)
    aligned = Alignment(at(0.1 + away, 0), Status.OK, 1.0, 0.001, 0.1, 0.01, 0.4, None, 5, displacement=0.01)
    result = TrackingResult(T_wc.numpy(), Status.OK, 100, 50, 0.01, np.diag([sigma**2, 0, 0, 0, 0, 0]), 40, Refuting())  # type: ignore[arg-type]
    front_end._begin = lambda view: None  # type: ignore[method-assign]
    front_end.search.best = lambda view, motion: (aligned, RegisteredPose(keyframe(0, 0.0), result))  # type: ignore[method-assign]
    front_end._displaced = lambda *_: 0.5  # type: ignore[method-assign]
    front_end.aligner.evidence = lambda view, T, references: replace(aligned, T_wc=T)  # type: ignore[method-assign]
    front_end.frames.append(0.0, T_wc, Status.OK)
    tracked = front_end.track(keyframe(2, 0.1))
    assert tracked.source is Source.REGISTERED and torch.equal(tracked.T_wc, T_wc)
    assert tracked.status is (Status.DOUBTFUL if doubtful else Status.OK)


@pytest.mark.parametrize(("predicted", "kept"), [(0.06, False), (0.02, True)])
def test_an_alignment_that_nothing_measures_does_not_run_away(predicted: float, kept: bool) -> None:
    """predicted: place along the wall [m]; the alignment ends at 0.1 m."""
    front_end = Slam(FAST).front_end
    assert isinstance(front_end, AlignmentToMap)
    covariance = torch.diag(torch.tensor([0.04**2] * 3 + [1e-6] * 3, dtype=torch.float64))
    found = Alignment(at(0.1, 0), Status.DEGENERATE, 1.0, 0.001, 0.1, 0.01, 1.0, None, 5, covariance)
    front_end._begin = lambda view: None  # type: ignore[method-assign]
    front_end.search.best = lambda view, motion: (found, None)  # type: ignore[method-assign]
    front_end.frames.append(0.0, at(0.0, 0), Status.OK)
    tracked = front_end.track(keyframe(2, predicted))
    assert tracked.status is Status.DOUBTFUL and not tracked.may_be_mapped
    assert float(tracked.T_wc[0, 3]) == pytest.approx(predicted if kept else 0.1)
    assert tracked.continues_motion is not kept


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


def test_the_evaluation_judges_what_was_reported(known_run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Of 14 frames, 8 and 10 were 8 cm off when they were reported, and only 8 was doubted. Frames 4 and 5 were right, and called lost."""
    folder = shutil.copytree(known_run, tmp_path / "out")
    live, log = load_tum(folder / "live_trajectory.txt"), known_log()
    live.poses[[8, 10], 2, 3] += 0.08
    log.lines[8] = replace(log.lines[8], status=Status.DOUBTFUL, live_status=Status.DOUBTFUL)
    save_tum(folder / "live_trajectory.txt", live)
    log.save(folder / "frames.csv")
    evaluation = evaluate_folder(folder)
    assert evaluation.doubt == DoubtRates(off=2, missed=1, good=11, false_alarms=2, passages=2, passages_missed=1)
    assert evaluation.measured is not None and evaluation.measured.frames == BOX_FRAMES - 2  # the doubtful frame is one of them
    assert json.loads((folder / "evaluation.json").read_text())["doubt"]["missed_rate"] == 0.5
    print_evaluation(evaluation, folder, Console(width=150))
    told = re.sub(" +", " ", capsys.readouterr().out.replace("│", ""))
    assert "frames off by more than 5 cm or 2 degrees, called good [%] 50.0 (1 of 2)" in told
    assert "good frames called doubtful or lost [%] 18.2 (2 of 11)" in told
    (folder / "live_trajectory.txt").unlink()
    assert evaluate_folder(folder).doubt is None  # an older result folder


def test_the_largest_jump_by_hand(capsys: pytest.CaptureFixture[str]) -> None:
    truth = np.tile(np.eye(4), (6, 1, 1))
    estimate = truth.copy()
    estimate[3:, 0, 3] = 0.07
    estimate[4:, :3, :3] = [[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1]]  # a turn of 36.87 degrees
    evaluation = evaluate_poses(estimate, truth)
    jump = evaluation.rpe[0].largest_jump
    assert (jump.translation_frame, jump.rotation_frame) == (3, 4)
    assert (jump.translation_m, jump.rotation_deg) == pytest.approx((0.07, 36.8699))
    assert evaluation.to_dict()["jump"]["rotation_frame"] == 4
    assert evaluation.rpe[0].rotation.rmse == pytest.approx(36.8699 / 5**0.5)
    print_evaluation(evaluation, Path("out"), Console(width=150))
    told = re.sub(" +", " ", capsys.readouterr().out.replace("│", ""))
    assert "largest jump to the next frame [cm] 7.00, at frame 3" in told and "[deg] 36.87, at frame 4" in told


def test_the_run_tells_doubtful_frames(box_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data, doubtful = open_recording(box_recording), (4, 5, 6)
    made = partial(Slam, front_end=lambda system: Knowing(np.asarray(data.ground_truth), doubtful))
    done = run_recording(data, small(), tmp_path / "out", make_slam=made)
    print_run(done, Console(width=150))
    assert ", lost frames 0, doubtful frames 3, peak memory " in capsys.readouterr().out
    metrics = json.loads((tmp_path / "out/metrics.json").read_text())
    assert (metrics["doubtful_frames"], metrics["doubtful_share"]) == (3, pytest.approx(3 / BOX_FRAMES))
    assert (metrics["doubt"]["good"], metrics["doubt"]["false_alarms"], metrics["measured"]["frames"]) == (13, 3, BOX_FRAMES)
    log = FinishedRun(tmp_path / "out").frames
    assert log is not None and [line.index for line in log.lines if line.status is Status.DOUBTFUL] == [4, 5, 6]
    assert log.lines[4].sigma_position == pytest.approx(0.03) and log.lines[0].sigma_position is None
    live = load_tum(tmp_path / "out/live_trajectory.txt")
    assert len(live) == BOX_FRAMES and np.abs(live.poses[:, :3, 3] - done.trajectory.poses[:, :3, 3]).max() < 0.02
    assert len(leave_out_lost(tmp_path / "out")) == BOX_FRAMES  # doubtful poses are measured


def test_progress_tells_doubtful_frames() -> None:
    with ProgressBar(None, None) as bar:
        bar.resume(done=3, keyframes=2, lost=0, doubtful=1)
        bar.update(FrameResult(3, 0.1, np.eye(4), Status.DOUBTFUL, False, {}), frames_per_second=9.0, keyframes=None)
        assert bar._counts() == "keyframes 2, doubtful 2"
        bar.finish(keyframes=3, lost=1, doubtful=2)
        assert bar._counts() == "keyframes 3, lost 1, doubtful 2"


def test_which_statuses_are_trusted() -> None:
    assert [status for status in Status if status.trusted] == [Status.OK, Status.DEGENERATE]
    assert [status for status in Status if status.measured] == [Status.OK, Status.DEGENERATE, Status.DOUBTFUL]
