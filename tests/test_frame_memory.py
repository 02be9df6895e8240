"""Values that parts remember of frames: worked out once, gone with the frame, and found again by its index after a restart."""

import gc

import torch

from idfslam.storage.frame_memory import FrameMemory


class Seen:
    """A frame."""

    def __init__(self, index: int) -> None:
        self.index = index


def memory(*frames: Seen) -> FrameMemory[int]:
    """Ten times the index of each frame."""
    made: FrameMemory[int] = FrameMemory()
    for frame in frames:
        made[frame] = 10 * frame.index
    return made


def never() -> int:
    raise AssertionError("there is a value already")


def test_a_value_is_worked_out_once() -> None:
    frame, made = Seen(3), memory()
    assert made.get(frame) is None
    assert made.of(frame, lambda: 30) == made.of(frame, never) == made.get(frame) == 30


def test_another_frame_of_the_same_index_has_its_own() -> None:
    first, made = Seen(3), memory()
    made[first] = 1
    assert made.get(Seen(3)) is None


def test_it_goes_with_the_frame() -> None:
    kept, gone = Seen(1), Seen(2)
    made = memory(kept, gone)
    del gone
    gc.collect()
    assert made.state() == {"1": 10}


def test_what_is_forgotten_is_worked_out_anew() -> None:
    frame = Seen(1)
    made = memory(frame)
    made.forget(frame)
    made.forget(frame)
    assert made.get(frame) is None
    assert made.of(frame, lambda: 11) == 11


def test_state() -> None:
    frames = [Seen(12), Seen(2)]
    made, again = memory(*frames), memory()
    assert list(made.state()) == ["2", "12"]
    again.restore(made.state())
    assert again.state() == made.state()
    same = [Seen(12), Seen(2)]
    assert [again.of(frame, never) for frame in same] == [120, 20]
    assert again.get(Seen(12)) is None  # that of the frame that asked first
    assert again.state() == made.state()


def test_restored_values_can_be_set_and_forgotten_before_their_frame_asks() -> None:
    frames = [Seen(1), Seen(2)]
    again = memory()
    again.restore(memory(*frames).state())
    again[frames[0]] = 5
    again.forget(frames[1])
    assert again.state() == {"1": 5}
    assert again.get(frames[1]) is None


def test_restoring_takes_the_place_of_what_was_there() -> None:
    frames = [Seen(1), Seen(2)]
    made, once = memory(*frames), memory(frames[0])
    made[frames[0]] = 99
    made.restore(once.state())
    assert made.state() == {"1": 10}
    assert made.get(frames[0]) == 10


def test_values_are_loaded() -> None:
    frame: Seen = Seen(1)
    made: FrameMemory[torch.Tensor] = FrameMemory()
    made.restore({"1": torch.ones(2)}, lambda value: value.double())
    value = made.get(frame)
    assert value is not None
    assert value.dtype == torch.float64
