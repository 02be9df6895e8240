"""The archive: what keyframes that have not been used for long hold in memory, in a temporary file.

However long a recording, the images of so many keyframes are in memory and no more; the file goes with the process. Nothing is packed:
replay asks for some of them at each update of the map, and the system's cache gives them faster than anything unpacks.
"""

import tempfile
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor


class Archived(Protocol):
    """What holds tensors that can be put away and had again."""

    def put_away(self) -> None: ...


@dataclass(frozen=True)
class Stored:
    """Tensors in the archive's file: where the first begins, and what each is; they follow each other."""

    offset: int
    kinds: tuple[tuple[torch.Size, torch.dtype], ...]


class Archive:
    """Lets the `in_memory` most recently used owners hold what they hold, and has the others put it away into its file."""

    def __init__(self, in_memory: int) -> None:
        self.in_memory = in_memory
        self._loaded: OrderedDict[int, Archived] = OrderedDict()  # the least recently used first
        self._file = tempfile.TemporaryFile(prefix="idf-slam-")  # noqa: SIM115 (open as long as the archive)
        self._end = 0

    def used(self, key: int, owner: Archived) -> None:
        """What the owner holds was just used; those that have not been used for longest put theirs away."""
        self._loaded[key] = owner
        self._loaded.move_to_end(key)
        while len(self._loaded) > self.in_memory:
            self._loaded.popitem(last=False)[1].put_away()

    def write(self, tensors: Sequence[Tensor]) -> Stored:
        """Puts tensors into the file."""
        stored = Stored(self._end, tuple((tensor.shape, tensor.dtype) for tensor in tensors))
        self._file.seek(self._end)
        for tensor in tensors:
            self._end += self._file.write(_raw(tensor.cpu().contiguous()))
        return stored

    def read(self, stored: Stored) -> list[Tensor]:
        """The tensors that were put there, exactly as they were, on the CPU."""
        tensors = [torch.empty(shape, dtype=dtype) for shape, dtype in stored.kinds]
        self._file.seek(stored.offset)
        for tensor in tensors:
            self._file.readinto(_raw(tensor))
        return tensors


def _raw(tensor: Tensor) -> memoryview:
    """A tensor's own bytes."""
    return tensor.flatten().view(torch.uint8).numpy().data
