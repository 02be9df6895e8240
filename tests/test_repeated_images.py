"""Repeated images: colour or depth of the frame before once more, while the camera moves on."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from helpers.small_config import small
from idfslam.datasets.generated.room import SyntheticRoom
from idfslam.frame import Frame, Status
from idfslam.geometry.camera import Camera
from idfslam.slam import Slam
from idfslam.slam.repeated_images import RepeatedImages

CAMERA = Camera(32, 24, 30.0, 30.0, 15.5, 11.5)
STALL = range(14, 20)  # frames with the image of frame 13


def frame(index: int, colour: float, depth: float) -> Frame:
    return Frame(index, index / 30, np.full((24, 32, 3), colour, np.float32), np.full((24, 32), depth, np.float32), CAMERA)


def test_a_repeated_depth_image_is_left_out(caplog: pytest.LogCaptureFixture) -> None:
    repeated = RepeatedImages()
    frames = [frame(0, 0.1, 1.0), frame(1, 0.2, 1.0), frame(2, 0.3, 1.0), frame(3, 0.4, 1.1)]
    assert [repeated.check(f).depth.any() for f in frames] == [True, False, False, True]
    assert repeated.colour_since == 3
    assert [record.getMessage() for record in caplog.records] == [
        "frame 1 repeats the depth image of the frame before: colour alone tells of its pose"
    ]


def test_a_repeated_colour_image_is_told_with_the_frame_that_showed_it_first() -> None:
    repeated, since = RepeatedImages(), []
    for i, colour in enumerate((0.1, 0.2, 0.2, 0.2, 0.3)):
        assert repeated.check(frame(i, colour, 1 + 0.1 * i)).depth.any()
        since.append(repeated.colour_since)
    assert since == [0, 1, 1, 1, 4]


def test_of_a_frame_that_is_repeated_as_a_whole_counts_what_did_before() -> None:
    """A camera that stands still, without noise, looks the same; and frames without any reading are no repeated depth."""
    repeated = RepeatedImages()
    first = frame(0, 0.1, 1.0)
    repeated.check(first)
    again = replace(first, index=1)
    assert repeated.check(again) is again and repeated.colour_since == 1
    older_depth = frame(2, 0.2, 1.0)
    assert not any(repeated.check(replace(older_depth, index=i)).depth.any() for i in (2, 3))
    older_colour = frame(4, 0.2, 1.1)
    for i in (4, 5):
        assert repeated.check(replace(older_colour, index=i)).depth.any() and repeated.colour_since == 3
    for i in (6, 7):
        empty = frame(i, 0.1 * i, 0.0)
        assert repeated.check(empty) is empty


def test_it_goes_on_from_its_state() -> None:
    repeated, other = RepeatedImages(), RepeatedImages()
    other.restore(repeated.state())
    for i, colour in enumerate((0.1, 0.2)):
        repeated.check(frame(i, colour, 1.0 + i))
    other.restore(repeated.state())
    other.check(frame(2, 0.2, 5.0))
    assert other.colour_since == 1


@pytest.mark.slow
@pytest.mark.parametrize("which", ["colour", "depth"])
def test_a_camera_that_stalls_does_not_hold_the_pose(which: str) -> None:
    """The camera moves 6.7 cm meanwhile. Poses are within 1.8 cm, as without a stall. If both images are believed, 5.6 and 10.9 cm."""
    room = SyntheticRoom(3, 24, 160, 120, noise=True)
    torch.set_num_threads(1)
    slam, results = Slam(small()), []
    for i in range(len(room)):
        f = room[i]
        results.append(slam.process(replace(f, **{which: getattr(room[13], which)}) if i in STALL else f))
    T_true = np.linalg.inv(room.ground_truth[0]) @ room.ground_truth
    off = np.array([np.linalg.norm(r.T_wc[:3, 3] - T[:3, 3]) for r, T in zip(results, T_true)])
    assert off.max() < 0.02
    told = Status.OK if which == "colour" else Status.DEGENERATE  # depth tells all directions here
    assert [results[i].status for i in STALL] == [told] * len(STALL)
    assert all(r.status is Status.OK for i, r in enumerate(results) if i not in STALL)
