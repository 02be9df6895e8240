"""Frames rendered in the background."""

import threading
from functools import cache

import numpy as np
import pytest

from idfslam.datasets.generated.prerendered import Prerendered
from idfslam.datasets.generated.room import SyntheticRoom
from idfslam.datasets.recording import reading_threads
from idfslam.errors import FrameError
from idfslam.frame import Frame


@cache
def room() -> SyntheticRoom:
    return SyntheticRoom(0, frames=6, width=32, height=24)


class Counted(SyntheticRoom):
    """That room, which says which frames were rendered, and when so many have been; frame `bad` cannot be."""

    def __init__(self, until: int, *, bad: int = -1) -> None:
        vars(self).update(vars(room()))  # built once
        self.asked: list[int] = []
        self.bad, self.until, self.reached = bad, until, threading.Event()

    def __getitem__(self, index: int) -> Frame:
        self.asked.append(index)
        if len(self.asked) == self.until:
            self.reached.set()
        if index == self.bad:
            raise FrameError("frame 1 is torn")
        return super().__getitem__(index)


def test_frames_are_rendered_in_the_background_and_once() -> None:
    counted = Counted(3)
    with Prerendered(counted, most=3) as prerendered:
        assert counted.reached.wait(60)
    assert (prerendered.name, len(prerendered), reading_threads(prerendered)) == (counted.name, 6, 2)
    again = room()
    for i in range(6):
        assert np.array_equal(prerendered[i].colour, again[i].colour)
    assert counted.asked == [0, 1, 2, 3, 4, 5]
    assert np.array_equal(prerendered[0].depth, again[0].depth)  # read again, it is rendered again
    assert counted.asked[-1] == 0


def test_reading_a_frame_that_cannot_be_rendered_raises_its_error() -> None:
    counted = Counted(2, bad=1)
    with Prerendered(counted, most=6) as prerendered:
        assert counted.reached.wait(60)
    assert counted.asked == [0, 1]
    with pytest.raises(FrameError, match="frame 1 is torn"):
        prerendered[1]


def test_it_ends_with_the_context() -> None:
    counted = Counted(1)
    with Prerendered(counted, most=6) as prerendered:
        assert counted.reached.wait(60)
    rendered = len(counted.asked)
    assert all(thread.name != "prerender" for thread in threading.enumerate())
    assert len(counted.asked) == rendered
    assert prerendered.surface() is not None
