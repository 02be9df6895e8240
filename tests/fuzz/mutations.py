"""Random damage to files and folders, of the kinds that copies, editors, other programs and unkind people cause."""

import os
import re
import shutil
import struct
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path
from random import Random

NASTY_NUMBERS = (
    *(b"0", b"-0", b"-1", b"1", b"2", b"255", b"65535", b"65536", b"2147483648", b"4294967295", b"9223372036854775808", b"1.5"),
    *(b"1e308", b"-1e308", b"1e-320", b"1e999", b"-1e999", b"nan", b"NaN", b"inf", b"Infinity", b"-Infinity", b"1e3"),
    *(b"0x10", b"1_000", b"07", b"1,5", b"9" * 400, b"9" * 5000, b"-" + b"9" * 400, b"1." + b"3" * 400, b"\xc2\xb2", b"\xd9\xa3", b""),
)
NASTY_VALUES = (
    *(b"null", b"true", b"[]", b"{}", b'""', b'"a"', b"[[1]]", b'{"a":1}', b"[1,2,3]", b"-", b"~", b"[null]", b"NaN", b"'"),
    *(b'"\\u0000"', b'"\\ud800"', b"2001-13-45", b"!!python/name:os.system", b"*a", b"&a [*a]", b"? [1]", b"<<: 5"),
    *(b"!!binary x", b"!!float x", b"!!timestamp x", b"!!int ''", b"!!bool x"),
    *(b"[" * 200, b"[" * 3000, b'{"a":' * 300, b"[" * 60 + b"]" * 60, b"[" * 900 + b"]" * 900),
)
NASTY_BYTES = (
    *(b"\0", b"\0" * 64, b"\xff", b"\xff\xfe", b"\xef\xbb\xbf", b"\r", b"\n", b"\n\n", b"\t", b" ", b"\x1a"),
    *(b"\\", b"/", b"../", b",", b";", b"#", b'"', b"%"),
)
NASTY_NAMES = ("rgb", "depth", "1", "000001.png", "9" * 200, "a" * 200 + ".png", "-1.png", "nan.png", "\udcff.png", ".hidden", "b\n.png")
_NUMBER = re.compile(rb"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?")
_WORD = re.compile(rb"[A-Za-z_]\w*")
_VALUE = re.compile(rb'"[^"]*"|\[[^][]*\]|\{[^{}]*\}|' + _NUMBER.pattern)

Mutate = Callable[[bytes, Random], bytes]


def mutated(data: bytes, rng: Random) -> bytes:
    """The bytes after one to four kinds of damage, mostly one."""
    is_text = b"\0" not in data[:512] and sum(byte < 128 for byte in data[:512]) > 0.95 * min(len(data), 512)
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        data = rng.choice(_OF_TEXT if is_text else _OF_BYTES)(data, rng)
    return data


def _flip(data: bytes, rng: Random) -> bytes:
    changed = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 8, 32)) if data else 0):
        changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def _flip_head(data: bytes, rng: Random) -> bytes:
    """Most formats have their sizes and counts at the beginning."""
    return _flip(data[:256], rng) + data[256:]


def _overwrite(data: bytes, rng: Random) -> bytes:
    start, length = _place(data, rng), rng.choice((1, 2, 4, 8, 16))
    return data[:start] + rng.choice((bytes(length), b"\xff" * length, rng.randbytes(length))) + data[start + length :]


def _number_field(data: bytes, rng: Random) -> bytes:
    """A count, size or offset of 1, 2, 4 or 8 bytes, in either order of bytes."""
    form, bits = rng.choice((("B", 8), ("H", 16), ("I", 32), ("Q", 64)))
    most, middle = (1 << bits) - 1, 1 << (bits - 1)
    value = rng.choice((0, 1, 2, most, middle, middle - 1, rng.randrange(most), min(most, rng.randrange(4096))))
    start = _place(data, rng)
    return data[:start] + struct.pack(rng.choice("<>") + form, value) + data[start + bits // 8 :]


def _float_field(data: bytes, rng: Random) -> bytes:
    form, size = rng.choice((("f", 4), ("d", 8)))
    value = rng.choice((float("nan"), float("inf"), -float("inf"), 0.0, -1.0, 3e38, 1e-40))
    start = _place(data, rng) & ~3
    return data[:start] + struct.pack("<" + form, value) + data[start + size :]


def _cut(data: bytes, rng: Random) -> bytes:
    return data[: rng.randrange(len(data) + 1)]


def _cut_out(data: bytes, rng: Random) -> bytes:
    start = _place(data, rng)
    return data[:start] + data[start + rng.choice((1, 2, 4, 16, 100, 1000)) :]


def _repeat(data: bytes, rng: Random) -> bytes:
    start, length = _place(data, rng), rng.choice((1, 4, 16, 100))
    return data[: start + length] + data[start : start + length] * rng.choice((1, 1, 3, 100)) + data[start + length :]


def _splice(data: bytes, rng: Random) -> bytes:
    a, b, length = _place(data, rng), _place(data, rng), rng.choice((4, 16, 64))
    return data[:a] + data[b : b + length] + data[a + length :]


def _insert(data: bytes, rng: Random) -> bytes:
    start = _place(data, rng)
    return data[:start] + rng.choice((*NASTY_BYTES, *NASTY_NUMBERS, rng.randbytes(8))) + data[start:]


def _number(data: bytes, rng: Random) -> bytes:
    return _in_place_of(_NUMBER, data, rng, NASTY_NUMBERS)


def _value(data: bytes, rng: Random) -> bytes:
    return _in_place_of(_VALUE, data, rng, (*NASTY_NUMBERS, *NASTY_VALUES))


def _word(data: bytes, rng: Random) -> bytes:
    words = _WORD.findall(data)[:200] or [b"a"]
    return _in_place_of(_WORD, data, rng, (b"", b"x", b"a" * 5000, b"null", b"path", rng.choice(words)))


def _line(data: bytes, rng: Random) -> bytes:
    """Lines exchanged, doubled, removed, joined, indented or emptied."""
    lines = data.split(b"\n")
    i, j = rng.randrange(len(lines)), rng.randrange(len(lines))
    line = lines[i]
    lines[i] = rng.choice((lines[j], b"", line + lines[j], b" " + line, line[: len(line) // 2], line + b"\n" + line, b"#" + line))
    return b"\n".join(lines)


def _encode(data: bytes, rng: Random) -> bytes:
    text = data.decode("utf-8", errors="replace")
    ends = data.replace(b"\n", b"\r\n"), data.replace(b"\n", b"\r"), data + b"\0"
    return rng.choice((b"\xef\xbb\xbf" + data, text.encode("utf-16"), text.encode("utf-16-le"), *ends))


def _replace_all(data: bytes, rng: Random) -> bytes:
    others = (b"", b"\n", b"\0" * 100, b"[]", b"{}", b"null", b"5", b'"a"', b"PK", b"\x89PNG\r\n\x1a\n", b"[" * 5000)
    return rng.choice((*others, rng.randbytes(200)))


def _png_header(data: bytes, rng: Random) -> bytes:
    """Another size, bit depth or kind in the first PNG header, with its checksum made right again."""
    start = data.find(b"IHDR")
    if start < 0:
        return _flip_head(data, rng)
    sizes = (0, 1, 2, 7, 1 << 15, 1 << 20, (1 << 31) - 1, (1 << 32) - 1)
    bits, kind, interlaced = rng.choice((1, 8, 16, 16, 5)), rng.choice((0, 0, 2, 3, 4, 6)), rng.choice((0, 1))
    header = b"IHDR" + struct.pack(">2I5B", rng.choice(sizes), rng.choice(sizes), bits, kind, 0, 0, interlaced)
    return data[:start] + header + struct.pack(">I", zlib.crc32(header)) + data[start + 21 :]


def _zip_field(data: bytes, rng: Random) -> bytes:
    """Flags, method, version, sizes or name length of an entry: encrypted, of unknown method, of another size."""
    starts = [m.start() for m in re.finditer(rb"PK\x01\x02|PK\x03\x04", data)]
    if not starts:
        return _number_field(data, rng)
    start = rng.choice(starts)
    at = start + rng.choice((4, 6, 8, 10, 14, 18, 20, 22, 24, 26, 28, 30, 38, 42))
    return data[:at] + rng.choice((b"\1", b"\xff", b"\x63\0", b"\x0c\0", b"\x0e\0", b"\0\0", b"\xff\xff\xff\xff", b"\x41")) + data[at + 1 :]


_OF_BYTES: tuple[Mutate, ...] = (
    *(_flip, _flip, _flip_head, _overwrite, _number_field, _number_field, _float_field, _cut, _cut_out, _repeat, _splice, _insert),
    *(_png_header, _zip_field, _replace_all),
)
_OF_TEXT: tuple[Mutate, ...] = (
    *(_number, _number, _number, _value, _value, _word, _line, _line, _flip, _cut, _cut_out, _repeat, _splice, _insert),
    *(_encode, _replace_all),
)


def _place(data: bytes, rng: Random) -> int:
    return rng.randrange(min(len(data), rng.choice((64, 1024, len(data)))) + 1) if data else 0


def _in_place_of(pattern: "re.Pattern[bytes]", data: bytes, rng: Random, others: Sequence[bytes]) -> bytes:
    found = list(pattern.finditer(data))
    if not found:
        return _insert(data, rng)
    place = rng.choice(found)
    return data[: place.start()] + rng.choice(others) + data[place.end() :]


def damage_folder(folder: Path, rng: Random) -> None:
    """One change of the files themselves: removed, renamed, doubled, emptied, turned into folders or links."""
    entries = sorted(path for path in folder.rglob("*") if not path.is_symlink())
    path = rng.choice(entries)
    other = path.with_name(rng.choice(sorted({*NASTY_NAMES, *(entry.name for entry in entries)})))
    kind = rng.choice(("remove", "move", "copy", "folder", "link", "empty", "exchange"))
    if kind in ("move", "copy"):
        if not other.exists():
            path.rename(other) if kind == "move" else shutil.copytree(path, other) if path.is_dir() else shutil.copy(path, other)
        return
    data = b"" if kind != "exchange" else rng.choice([entry for entry in entries if entry.is_file()]).read_bytes()
    _remove(path)
    if kind == "folder":
        path.mkdir()
    elif kind == "link":
        path.symlink_to(rng.choice((path, folder, Path("/nowhere"), path.parent, Path("/dev/null"))))
    elif kind != "remove":
        path.write_bytes(data)


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path)
    else:
        os.unlink(path)
