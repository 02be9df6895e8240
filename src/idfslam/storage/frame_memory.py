"""Values that a part stores for frames. A value is deleted with its frame, and saved in a checkpoint under the frame's index."""

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
    """One value for each frame, computed on first use."""

    def __init__(self) -> None:
        self._values: WeakKeyDictionary[Indexed, Value] = WeakKeyDictionary()
        self._restored: dict[int, Value] = {}  # values from a checkpoint by index, until their frames are used

    def of(self, frame: Indexed, make: Callable[[], Value]) -> Value:
        """The frame's value; `make` computes it if there is none yet."""
        if self.get(frame) is None:
            self._values[frame] = make()
        return self._values[frame]

    def get(self, frame: Indexed) -> Value | None:
        """The frame's value, if there is one."""
        if frame not in self._values and frame.index in self._restored:
            self._values[frame] = self._restored.pop(frame.index)
        return self._values.get(frame)

    def __setitem__(self, frame: Indexed, value: Value) -> None:
        self._restored.pop(frame.index, None)
        self._values[frame] = value

    def forget(self, frame: Indexed) -> None:
        """Deletes the frame's value; it is computed anew on next use."""
        self._values.pop(frame, None)
        self._restored.pop(frame.index, None)

    def state(self) -> State:
        """The values by frame index."""
        return {str(index): value for index, value in sorted(self._by_index().items())}

    def restore(self, state: State, load: Callable[[Value], Value] = lambda value: value) -> None:
        """Replaces all values by those of `state`, each converted by `load`."""
        self._values.clear()
        self._restored = {int(index): load(value) for index, value in state.items()}

    def _by_index(self) -> dict[int, Value]:
        return self._restored | {frame.index: value for frame, value in list(self._values.items())}
