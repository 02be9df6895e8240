"""The swap file: a temporary file with the images and features of keyframes that have not been used for long.

It bounds the number of keyframes with images in memory, however long the recording is. The file is deleted with the process, however that
ends. Its tensors are not compressed: replay reads some of them at each update of the map, and reading from the system's cache is faster
than decompressing. It leaves room on its disk; where there is none, the images stay in memory.
"""

import logging
import shutil
import tempfile
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from io import FileIO
from pathlib import Path
from typing import Protocol, cast

import torch
from torch import Tensor

log = logging.getLogger(__name__)

# [bytes] of the disk that the swap file leaves free for results and checkpoints; more: images stay in memory earlier. Chosen by hand: a
# checkpoint of the largest feature grid with its optimiser takes about half of it
LEFT_FREE = 1 << 28


class Swappable(Protocol):
    """An owner of tensors that can be released from memory and read again."""

    def swap_out(self) -> None:
        """Releases the tensors from memory."""
        ...


@dataclass(frozen=True)
class Stored:
    """Where tensors lie in the file, one after the other."""

    offset: int  # [bytes] of the first tensor
    kinds: tuple[tuple[torch.Size, torch.dtype], ...]  # shape and dtype of each tensor


class SwapFile:
    """Keeps the tensors of the `in_memory` most recently used owners in memory. All others put theirs into the file."""

    def __init__(self, in_memory: int) -> None:
        self.in_memory = in_memory
        self.folder: Path | None = None  # where the file is made; None: the folder of temporary files. Set before the first write
        self.full = False  # whether a write has failed; no other is tried
        self._loaded: OrderedDict[int, Swappable] = OrderedDict()  # least recently used first
        self._file: FileIO | None = None  # made at the first write
        self._end = 0

    def used(self, key: int, owner: Swappable) -> None:
        """Notes that an owner's tensors are in use. The least recently used owners put theirs away."""
        self._loaded[key] = owner
        self._loaded.move_to_end(key)
        while len(self._loaded) > self.in_memory:
            self._loaded.popitem(last=False)[1].swap_out()

    def write(self, tensors: Sequence[Tensor]) -> Stored | None:
        """Appends tensors to the file; returns where they are, or None if they could not be written."""
        stored = Stored(self._end, tuple((tensor.shape, tensor.dtype) for tensor in tensors))
        data = [_raw(tensor.cpu().contiguous()) for tensor in tensors]
        try:
            self._append(data)
        except OSError as error:
            self.full = True
            why = error.strerror or error
            log.warning("%s: %s; the images of further keyframes stay in memory", self.folder or "the folder of temporary files", why)
            return None
        self._end += sum(part.nbytes for part in data)
        return stored

    def _append(self, data: Sequence[memoryview]) -> None:
        """Writes at the end. Raises OSError, also if too little room would be left."""
        folder = self.folder or Path(tempfile.gettempdir())
        free = shutil.disk_usage(folder).free - sum(part.nbytes for part in data)
        if free < LEFT_FREE:
            raise OSError(f"less than {LEFT_FREE >> 20} MiB would be left on the disk")
        if self._file is None:
            file = tempfile.TemporaryFile(prefix=".part-", dir=folder, buffering=0)  # noqa: SIM115 (open as long as its owner)
            self._file = cast(FileIO, file)
        self._file.seek(self._end)
        for part in data:
            while part.nbytes:
                part = part[self._file.write(part) :]

    def read(self, stored: Stored) -> list[Tensor]:
        """Reads tensors back, exactly as they were written, on the CPU."""
        assert self._file is not None
        tensors = [torch.empty(shape, dtype=dtype) for shape, dtype in stored.kinds]
        self._file.seek(stored.offset)
        for tensor in tensors:
            part = _raw(tensor)
            while part.nbytes:
                part = part[self._file.readinto(part) :]
        return tensors


def _raw(tensor: Tensor) -> memoryview:
    """The bytes of a tensor, sharing its memory."""
    return tensor.flatten().view(torch.uint8).numpy().data
