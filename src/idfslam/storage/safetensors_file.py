"""What safetensors leaves open: the order of the header's keys, and whether the bytes are those that were written.

A file is the length of its header (8 bytes), the header (JSON, filled up with spaces), and the tensors one after the other.
"""

import hashlib
import json
import re
from pathlib import Path
from typing import BinaryIO

_LENGTH, _ALIGNMENT = 8, 8  # [bytes] of the header's length, and what the header is filled up to a multiple of: a fact of the format
_METADATA = "__metadata__"
_CHECKSUM = re.compile(rb'"sha256":"([0-9a-f]{64})"')
_BLOCK = 1 << 20  # [bytes] read at once; raised, more memory is taken. Chosen by hand
UNKNOWN = "0" * 64  # the checksum in the metadata while the file is written


def ordered(data: bytes) -> bytes:
    """A file's bytes with the header's keys in order. Equal tensors and metadata then give equal files."""
    end = _LENGTH + int.from_bytes(data[:_LENGTH], "little")
    header = json.loads(data[_LENGTH:end])
    metadata = dict(sorted(header.pop(_METADATA, {}).items()))
    tensors = dict(sorted(header.items(), key=lambda item: (item[1]["data_offsets"], item[0])))
    text = json.dumps({_METADATA: metadata, **tensors}, separators=(",", ":"), ensure_ascii=False).encode()
    text += b" " * (-len(text) % _ALIGNMENT)
    return len(text).to_bytes(_LENGTH, "little") + text + data[end:]


def seal(path: Path) -> None:
    """Enters the SHA-256 of the whole file, taken with UNKNOWN in its place, into the metadata's `sha256`, which is UNKNOWN so far."""
    with path.open("r+b") as file:
        found = _CHECKSUM.search(_header(file))
        assert found is not None, "the metadata has no sha256"
        digest = _digest(file, _LENGTH + found.start(1))
        file.seek(_LENGTH + found.start(1))
        file.write(digest.encode())


def is_intact(path: Path) -> bool | None:
    """Whether a sealed file is as it was written, to the bit; None for a file without a checksum. Raises OSError."""
    with path.open("rb") as file:
        found = _CHECKSUM.search(_header(file))
        return None if found is None else _digest(file, _LENGTH + found.start(1)) == found[1].decode()


def _header(file: BinaryIO) -> bytes:
    """The header; as much of it as there is."""
    size = file.seek(0, 2)
    file.seek(0)
    length = int.from_bytes(file.read(_LENGTH), "little")
    return file.read(min(length, size))


def _digest(file: BinaryIO, place: int) -> str:
    """The SHA-256 of the file with UNKNOWN at `place`."""
    digest = hashlib.sha256()
    file.seek(0)
    digest.update(file.read(place))
    digest.update(UNKNOWN.encode())
    file.seek(place + len(UNKNOWN))
    while block := file.read(_BLOCK):
        digest.update(block)
    return digest.hexdigest()
