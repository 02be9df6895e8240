"""Text as people's programs write it: UTF-8 with or without a byte order mark, or UTF-16 as Windows calls "Unicode"."""

import codecs
from pathlib import Path

_UTF16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


def read_text(path: Path) -> str:
    """The text of a file; bytes that are no text become U+FFFD. Line ends are those of Python's text files. Raises OSError."""
    data = path.read_bytes()
    encoding = "utf-16" if data.startswith(_UTF16) else _utf16_without_mark(data) or "utf-8-sig"
    return data.decode(encoding, errors="replace").replace("\r\n", "\n").replace("\r", "\n")


def _utf16_without_mark(data: bytes) -> str | None:
    """The encoding of digits and Latin letters in two bytes each, of which one is 0; None if the text is not that."""
    head = data[:64]
    if len(head) < 4 or len(data) % 2:
        return None
    return next((name for name, zero in (("utf-16-le", 1), ("utf-16-be", 0)) if not any(head[zero::2]) and all(head[1 - zero :: 2])), None)
