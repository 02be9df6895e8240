"""Text files are read as other programs write them."""

from pathlib import Path

import pytest

from idfslam.storage.text_file import read_text

TEXT = "525.0 0 319.5\n0 525.0 239.5\n"


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be"])
@pytest.mark.parametrize("line_end", ["\n", "\r\n", "\r"])
def test_every_encoding_gives_the_same_text(tmp_path: Path, encoding: str, line_end: str) -> None:
    path = tmp_path / "intrinsics.txt"
    path.write_bytes(TEXT.replace("\n", line_end).encode(encoding))
    assert read_text(path) == TEXT


def test_a_big_endian_mark_is_known(tmp_path: Path) -> None:
    path = tmp_path / "intrinsics.txt"
    path.write_bytes(b"\xfe\xff" + TEXT.encode("utf-16-be"))
    assert read_text(path) == TEXT


def test_bytes_that_are_no_text_are_replaced(tmp_path: Path) -> None:
    path = tmp_path / "intrinsics.txt"
    path.write_bytes(b"525 \xff 0\x00")
    assert read_text(path) == "525 � 0\x00"
    path.write_bytes(b"")
    assert read_text(path) == ""
