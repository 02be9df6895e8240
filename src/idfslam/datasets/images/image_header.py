"""The size that an image's header claims: OpenCV takes memory for it, and time, before it finds that the file holds no such image."""

import re
import struct

LONGEST_SIDE = 8192  # [px] of an image; raised, a damaged header makes more memory be taken. Chosen by hand
_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}  # JPEG's markers with the size; the three others are tables
_BARE = frozenset({0x01, *range(0xD0, 0xD9)})  # JPEG's markers without a length
_PNM = re.compile(rb"P[1-7]\s+(?:#[^\n]*\n\s*)*(\d{1,20})\s+(?:#[^\n]*\n\s*)*(\d{1,20})")


def claimed_size(data: bytes) -> tuple[int, int]:
    """Width and height [px] in the header of a PNG, JPEG, BMP or PNM file; (0, 0) for other files and without a header."""
    try:
        if data.startswith(b"\x89PNG"):
            return struct.unpack_from(">2I", data, 16)
        if data.startswith(b"\xff\xd8"):
            return _jpeg(data)
        if data.startswith(b"BM"):
            width, height = struct.unpack_from("<2i", data, 18)
            return abs(width), abs(height)
    except struct.error:  # cut off before it
        return 0, 0
    found = _PNM.match(data)
    return (int(found[1]), int(found[2])) if found else (0, 0)


def is_whole_png(data: bytes) -> bool:
    """Whether all chunks of a PNG file, by their stated lengths, lie in the file; OpenCV takes memory for what is missing."""
    at = 8
    while at + 12 <= len(data):
        (length,) = struct.unpack_from(">I", data, at)
        if data[at + 4 : at + 8] == b"IEND":
            return length == 0
        at += 12 + length
    return False


def _jpeg(data: bytes) -> tuple[int, int]:
    """From the first marker with a size; bytes between markers are skipped, as JPEG's library does."""
    at = 2
    while 0 <= (at := data.find(b"\xff", at)) < len(data) - 1:
        marker = data[at + 1]
        if marker in _FRAMES:
            height, width = struct.unpack_from(">2H", data, at + 5)
            return width, height
        if marker in (0x00, 0xFF):  # no marker
            at += 1
        else:
            at += 2 if marker in _BARE else 2 + struct.unpack_from(">H", data, at + 2)[0]
    return 0, 0
