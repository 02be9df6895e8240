"""What a part remembers of frames: it belongs to the part, dies with the frame, and is kept in a checkpoint by the frame's index."""

from collections.abc import Callable
from typing import Generic, Protocol, TypeVar
from weakref import WeakKeyDictionary

from idfslam.storage.state import State

Value = TypeVar("Value")


class Indexed(Protocol):
    """A frame or keyframe."""

    @property
    def index(self) -> int: ...


class FrameMemory(Generic[Value]):
    """One value a frame, worked out when it is first asked for."""

    def __init__(self) -> None:
        self._values: WeakKeyDictionary[Indexed, Value] = WeakKeyDictionary()
        self._restored: dict[int, Value] = {}  # of a checkpoint, by index, until its frame asks

    def of(self, frame: Indexed, make: Callable[[], Value]) -> Value:
        """The frame's value; `make` gives it where there is none yet."""
        if frame not in self._values:
            self._values[frame] = self._restored.pop(frame.index) if frame.index in self._restored else make()
        return self._values[frame]

    def get(self, frame: Indexed) -> Value | None:
        """The frame's value, if there is one."""
        return self.of(frame, lambda: self._restored[frame.index]) if frame in self._values or frame.index in self._restored else None

    def __setitem__(self, frame: Indexed, value: Value) -> None:
        self._restored.pop(frame.index, None)
        self._values[frame] = value

    def forget(self, frame: Indexed) -> None:
        """The frame's value is worked out anew when it is next asked for."""
        self._values.pop(frame, None)
        self._restored.pop(frame.index, None)

    def state(self) -> State:
        """The values by their frames' indices."""
        return {str(index): value for index, value in sorted(self._by_index().items())}

    def restore(self, state: State, load: Callable[[Value], Value] = lambda value: value) -> None:
        """Takes the values of `state`, each through `load`, in place of its own."""
        self._values.clear()
        self._restored = {int(index): load(value) for index, value in state.items()}

    def _by_index(self) -> dict[int, Value]:
        return self._restored | {frame.index: value for frame, value in list(self._values.items())}
