"""Which frame defines the world: one with much depth at once, one with little after a second, one without any never."""

import numpy as np
import pytest
import torch

from idfslam.frame import Frame, Status
from idfslam.geometry.camera import Camera
from idfslam.graph.keyframe import Keyframe
from idfslam.slam.world_origin import WorldOrigin

CAMERA = Camera(64, 48, 55.0, 55.0, 31.5, 23.5)


def view(rows: int, brightness: float = 0.5) -> Keyframe:
    """A view of one colour with depth in its lowest rows of 48."""
    depth = np.zeros((48, 64), np.float32)
    depth[48 - rows :] = 1.0
    frame = Frame(0, 0.0, np.full((48, 64, 3), brightness, np.float32), depth, CAMERA)
    return Keyframe(frame, torch.eye(4, dtype=torch.float64), torch.from_numpy(depth), torch.from_numpy(frame.colour))


@pytest.mark.parametrize(("rows", "share", "lost"), [(48, 1.0, 0), (8, 2 / 12, 0), (4, 1 / 12, 30)])
def test_the_less_depth_the_later(rows: int, share: float, lost: int) -> None:
    """lost: frames before the one that defines the world, all alike."""
    origin, seen = WorldOrigin(), view(rows)
    assert seen.depth_share == pytest.approx(share)
    statuses = [origin.track(seen).status for _ in range(lost + 1)]
    assert statuses == [Status.LOST] * lost + [Status.OK]


def test_a_frame_with_much_depth_ends_the_waiting() -> None:
    origin = WorldOrigin()
    assert [origin.track(view(rows)).status for rows in (0, 4, 4, 48)] == [Status.LOST] * 3 + [Status.OK]


def test_frames_without_depth_do_not_count() -> None:
    origin = WorldOrigin()
    assert {origin.track(view(0)).status for _ in range(100)} == {Status.LOST}
    assert origin.track(view(4)).status is Status.LOST


def test_it_waits_on_after_a_restart() -> None:
    origin, other = WorldOrigin(), WorldOrigin()
    for _ in range(30):
        origin.track(view(4))
    other.restore(origin.state())
    assert other.track(view(4)).status is Status.OK


def test_a_covered_lens_with_a_strip_of_depth_begins_nothing() -> None:
    origin = WorldOrigin()
    assert {origin.track(view(4, brightness=0.0)).status for _ in range(100)} == {Status.LOST}
    assert [origin.track(view(4)).status for _ in range(31)] == [Status.LOST] * 30 + [Status.OK]


def test_a_dark_room_with_much_depth_begins_at_once() -> None:
    assert WorldOrigin().track(view(48, brightness=0.0)).status is Status.OK
