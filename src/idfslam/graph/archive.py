"""The archive: a temporary file with the images and features of keyframes that have not been used for long.

It bounds the number of keyframes with images in memory, however long the recording is. The file is deleted with the process. Its tensors
are not compressed: replay reads some of them at each update of the map, and reading from the system's cache is faster than decompressing.
"""

import tempfile
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor


class Archived(Protocol):
    """An owner of tensors that can be released from memory and read again."""

    def put_away(self) -> None:
        """Releases the tensors from memory."""
        ...


@dataclass(frozen=True)
class Stored:
    """Where tensors lie in the archive's file, one after the other."""

    offset: int  # [bytes] of the first tensor
    kinds: tuple[tuple[torch.Size, torch.dtype], ...]  # shape and dtype of each tensor


class Archive:
    """Keeps the tensors of the `in_memory` most recently used owners in memory. All others put theirs into the file."""

    def __init__(self, in_memory: int) -> None:
        self.in_memory = in_memory
        self._loaded: OrderedDict[int, Archived] = OrderedDict()  # least recently used first
        self._file = tempfile.TemporaryFile(prefix="idf-slam-")  # noqa: SIM115 (open as long as the archive)
        self._end = 0

    def used(self, key: int, owner: Archived) -> None:
        """Notes that an owner's tensors are in use. The least recently used owners put theirs away."""
        self._loaded[key] = owner
        self._loaded.move_to_end(key)
        while len(self._loaded) > self.in_memory:
            self._loaded.popitem(last=False)[1].put_away()

    def write(self, tensors: Sequence[Tensor]) -> Stored:
        """Appends tensors to the file; returns where they are."""
        stored = Stored(self._end, tuple((tensor.shape, tensor.dtype) for tensor in tensors))
        self._file.seek(self._end)
        for tensor in tensors:
            self._end += self._file.write(_raw(tensor.cpu().contiguous()))
        return stored

    def read(self, stored: Stored) -> list[Tensor]:
        """Reads tensors back, exactly as they were written, on the CPU."""
        tensors = [torch.empty(shape, dtype=dtype) for shape, dtype in stored.kinds]
        self._file.seek(stored.offset)
        for tensor in tensors:
            self._file.readinto(_raw(tensor))
        return tensors


def _raw(tensor: Tensor) -> memoryview:
    """The bytes of a tensor, sharing its memory."""
    return tensor.flatten().view(torch.uint8).numpy().data
