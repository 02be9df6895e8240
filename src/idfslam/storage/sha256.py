"""The SHA-256 of a file's content, by which a file is known again."""

import hashlib
from pathlib import Path

_BLOCK = 1 << 20  # [bytes] read at once; raised, more memory is taken. Chosen by hand


def sha256(path: Path) -> str:
    """The hash as 64 hexadecimal digits. Raises OSError if the file cannot be read."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(_BLOCK):
            digest.update(block)
    return digest.hexdigest()
