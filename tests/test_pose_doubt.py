"""Doubt in an aligned pose: the model's numbers by hand, and right and wrong poses of a generated room."""

import math
from collections.abc import Iterator
from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch

from helpers.three_walls import error
from idfslam.alignment import pose_doubt
from idfslam.alignment.motion import moved
from idfslam.alignment.pose_doubt import PoseDoubt
from idfslam.config import FAST
from idfslam.datasets.generated.room import SyntheticRoom
from idfslam.frame import Frame, Status
from idfslam.slam import Slam
from idfslam.slam.front_end.alignment_to_map import AlignmentToMap

USUAL = math.radians(0.4)


@pytest.fixture
def known() -> PoseDoubt:
    doubt = PoseDoubt()
    doubt.expect([0.0, USUAL / 2, USUAL, 2 * USUAL])
    return doubt


def test_the_probability_by_hand(known: PoseDoubt, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pose_doubt, "_SLOPE", 5.0)
    monkeypatch.setattr(pose_doubt, "_OFFSET", -5.0)
    assert known.probability(math.e * USUAL) == pytest.approx(0.5)  # 5 ln e - 5 = 0
    assert known.probability(USUAL) == pytest.approx(1 / (1 + math.exp(5)))
    assert known.probability(0.0) == 0.0  # nothing was in view
    assert PoseDoubt().probability(math.radians(0.2)) == pytest.approx(1 / (1 + math.exp(5)))  # the least that counts as usual


def test_about_twice_the_usual_displacement_is_doubtful(known: PoseDoubt) -> None:
    assert not known.is_doubtful(1.5 * USUAL) and known.is_doubtful(3.0 * USUAL)


def test_what_is_usual_follows_the_recording_and_no_jump() -> None:
    doubt = PoseDoubt()
    assert not doubt.has_usual
    doubt.accept(0.004)
    assert doubt.has_usual and doubt.state() == {"usual": 0.004, "frames": 1}
    for displacement in (0.008, 0.4, 0.0048):  # up by a third, not for a wrong pose, down by a fifth
        doubt.accept(displacement)
    assert doubt.state()["usual"] == pytest.approx(0.004 * (4 / 3) / (6 / 5))
    for _ in range(200):
        doubt.accept(0.008)
    before = doubt.state()["usual"]
    doubt.accept(2 * before)  # one hundredth a frame, later on
    assert doubt.state()["usual"] == pytest.approx(1.01 * before)
    doubt.accept(0.0)  # says nothing
    again = PoseDoubt()
    again.restore(doubt.state())
    assert again.state() == doubt.state()


def test_images_that_contradict_throughout_do_not_become_usual() -> None:
    """A pose off by 2 degrees shows 1.41 degrees in the median landmark, and stays doubtful."""
    doubt = PoseDoubt()
    for _ in range(100):
        doubt.accept(0.05)
    assert doubt.is_doubtful(0.05)
    assert doubt.is_doubtful(math.radians(1.43)) and not doubt.is_doubtful(math.radians(1.40))


def test_a_doubtful_displacement_counts_by_the_probability_that_its_pose_is_right(known: PoseDoubt) -> None:
    for _ in range(200):
        known.accept(USUAL)
    before = known.state()["usual"]
    even = before * math.exp(5.7 / 5)  # 5 ln 3.1 - 5.7 = 0: right and wrong are equally probable
    assert known.is_doubtful(even)
    known.accept(even)
    assert known.state()["usual"] == pytest.approx(1.005 * before)
    for _ in range(30):
        known.accept(6 * before)  # a second of wrong poses
    assert known.state()["usual"] < 1.03 * before


@pytest.fixture(scope="module")
def after_ten_frames() -> Iterator[tuple[Slam, SyntheticRoom]]:
    room = SyntheticRoom(0, frames=240, width=320, height=240, noise=True)
    slam = Slam(replace(FAST, field=replace(FAST.field, table_log2=14)))
    for i in range(10):
        assert slam.process(room[i]).status is Status.OK
    yield slam, room


def blurred(frame: Frame) -> Frame:
    """A frame that was exposed while the image moved by 9 pixels."""
    return replace(frame, colour=cv2.blur(np.asarray(frame.colour), (9, 1)))


def test_a_blurred_image_at_the_right_pose_is_not_doubted_and_a_wrong_pose_is(after_ten_frames: tuple[Slam, SyntheticRoom]) -> None:
    slam, room = after_ten_frames
    front_end = slam.front_end
    assert isinstance(front_end, AlignmentToMap)
    aligner, references = front_end.aligner, slam.graph.references(2)
    T_wc = torch.from_numpy(np.linalg.inv(room.ground_truth[0]) @ room.ground_truth[10])
    for frame in (room[10], blurred(room[10])):
        view = slam._view(frame, T_wc)
        right = aligner.align(view, T_wc, references)
        assert error(right.T_wc, T_wc)[1] < 0.5 and not aligner.contradicts_images(right)
        for turn in ([0.0, 0.2, 0.0], [0.1, -0.15, 0.0]):  # [rad], too far for the images that are used
            guess = moved(T_wc, torch.tensor([0, 0, 0, *turn], dtype=torch.float64))
            wrong = aligner.align(view, guess, references, max_guess_error_px=0.5)
            assert error(wrong.T_wc, T_wc)[1] > 2 and aligner.contradicts_images(wrong)


@pytest.mark.slow
def test_a_run_trusts_a_blurred_frame_and_not_one_of_another_room() -> None:
    room = SyntheticRoom(0, frames=240, width=320, height=240, noise=True)
    slam = Slam(replace(FAST, field=replace(FAST.field, table_log2=14)))
    for i in range(10):
        slam.process(room[i])
    blurry = slam.process(blurred(room[10]))
    assert blurry.status is Status.OK
    truth = np.linalg.inv(room.ground_truth[0]) @ room.ground_truth[10]
    assert error(torch.from_numpy(blurry.T_wc), torch.from_numpy(truth))[1] < 0.5
    elsewhere = slam.process(replace(SyntheticRoom(5, frames=240, width=320, height=240)[100], index=11, timestamp=11 / 30))
    assert elsewhere.status in (Status.DOUBTFUL, Status.LOST)
