"""The headers of LZFSE's blocks: how large data become, known before memory is asked for (Apple, lzfse_internal.h)."""

import struct

_END = b"bvx$"


def unpacked_size(data: bytes) -> int:
    """The size [bytes] that LZFSE data unpack to; raises ValueError if they are cut off or no LZFSE."""
    at = size = 0
    try:
        while (kind := data[at : at + 4]) != _END:
            raw, length = _block(kind, data, at)
            size, at = size + raw, at + length
    except struct.error as error:
        raise ValueError(f"cut off after {len(data)} bytes") from error
    return size


def _block(kind: bytes, data: bytes, at: int) -> tuple[int, int]:
    """Unpacked size and length [bytes] of the block that begins at `at`."""
    (raw,) = struct.unpack_from("<I", data, at + 4)
    if kind == b"bvx-":  # not packed
        return raw, 8 + raw
    if kind == b"bvxn":  # LZVN
        return raw, 12 + struct.unpack_from("<I", data, at + 8)[0]
    if kind == b"bvx2":  # bit fields of three words: literals' and matches' bytes, and the header's
        literals, matches, header = struct.unpack_from("<3Q", data, at + 8)
        payload = (literals >> 20 & 0xFFFFF) + (matches >> 40 & 0xFFFFF)
        return raw, (header & 0xFFFFFFFF) + payload if header & 0xFFFFFFFF >= 32 else 32
    raise ValueError(f"no block of LZFSE but {kind!r} at byte {at}")
