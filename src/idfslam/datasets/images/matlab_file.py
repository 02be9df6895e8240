"""Arrays of numbers in MATLAB files of versions 5 to 7.2 (MathWorks, "MAT-File Format").

Not scipy's reader: damaged files crash it in native code, and with it the program.
"""

import math
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

_HEADER = 128  # [bytes] of text before the first element: a fact of the format
_MATRIX, _COMPRESSED = 14, 15  # types of elements: a fact of the format
_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}  # of stored numbers
_CLASSES = {6: "f8", 7: "f4", 8: "i1", 9: "u1", 10: "i2", 11: "u2", 12: "i4", 13: "u4", 14: "i8", 15: "u8"}  # of arrays
_MOST_UNPACKED = 1032  # [1] bytes that zlib makes of one at most: a stream that claims more is damaged


def is_hdf5(path: Path) -> bool:
    """Whether a MATLAB file is of version 7.3, which is HDF5. Raises OSError."""
    with path.open("rb") as file:
        return b"MATLAB 7.3" in file.read(_HEADER)


def read_matlab(path: Path) -> dict[str, NDArray[Any]]:
    """The real arrays of numbers by name, of any dimensions from 2; cells, structures and text are passed over.

    Raises OSError, and ValueError, IndexError, struct.error or zlib.error for a damaged file.
    """
    data = path.read_bytes()
    if len(data) < _HEADER or data[126:128] not in (b"IM", b"MI"):
        raise ValueError("not a MATLAB file of version 5")
    order = "<" if data[126:128] == b"IM" else ">"
    arrays: dict[str, NDArray[Any]] = {}
    for kind, content in _elements(data[_HEADER:], order):
        if kind == _COMPRESSED:
            unpacked = zlib.decompressobj().decompress(content, _MOST_UNPACKED * len(content) + 1)
            kind, content = next(_elements(unpacked, order), (0, b""))
        named = _array(content, order) if kind == _MATRIX else None
        if named is not None:
            arrays[named[0]] = named[1]
    return arrays


def _elements(data: bytes, order: str) -> Iterator[tuple[int, bytes]]:
    """Type and content of the elements of a stream. Contents of at most 4 bytes may stand in the tag itself."""
    at = 0
    while at + 8 <= len(data):
        kind, size = struct.unpack_from(f"{order}II", data, at)
        if kind >> 16:
            yield kind & 0xFFFF, data[at + 4 : at + 4 + min(kind >> 16, 4)]
            at += 8
            continue
        yield kind, data[at + 8 : at + 8 + size]
        at += 8 + size + (0 if kind == _COMPRESSED else -size % 8)


def _array(content: bytes, order: str) -> tuple[str, NDArray[Any]] | None:
    """Name and values of a matrix; None if it holds no real numbers."""
    elements = _elements(content, order)
    (_, flags), (_, sizes), (_, name) = next(elements), next(elements), next(elements)
    array_flags = struct.unpack_from(f"{order}I", flags)[0]
    shape = np.frombuffer(sizes, f"{order}i4").tolist()
    if array_flags & 0xFF not in _CLASSES or array_flags & 0x800 or not shape or min(shape) < 1:  # 0x800: complex
        return None
    kind, stored = next(elements)
    numbers = np.frombuffer(stored, np.dtype(order + _TYPES[kind]))
    if len(numbers) != math.prod(shape):
        raise ValueError(f"{len(numbers)} of {math.prod(shape)} numbers")
    return name.decode("latin-1"), numbers.astype(_CLASSES[array_flags & 0xFF]).reshape(shape, order="F")
