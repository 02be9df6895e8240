"""Files of tensors: equal content gives equal bytes, and a sealed file shows each change."""

from pathlib import Path

import torch
from safetensors import safe_open
from safetensors.torch import load, save, save_file

from idfslam.storage import safetensors_file
from idfslam.storage.safetensors_file import is_intact, ordered, seal

METADATA = {f"key {i}": "ä" * i for i in range(12)}
TENSORS = {"b": torch.arange(7, dtype=torch.uint8), "a": torch.rand(3, 4), "empty": torch.zeros(0, 2), "half": torch.ones(5).half()}


def test_equal_content_gives_equal_bytes() -> None:
    assert len({ordered(save(TENSORS, METADATA)) for _ in range(20)}) == 1
    assert ordered(save(dict(reversed(TENSORS.items())), METADATA)) == ordered(save(TENSORS, METADATA))
    assert ordered(ordered(save(TENSORS, METADATA))) == ordered(save(TENSORS, METADATA))


def test_nothing_is_lost(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(ordered(save(TENSORS, METADATA)))
    loaded = load((tmp_path / "file").read_bytes())
    assert loaded.keys() == TENSORS.keys()
    assert all(torch.equal(loaded[name], TENSORS[name]) for name in TENSORS)
    with safe_open(tmp_path / "file", "pt") as file:
        assert file.metadata() == METADATA


def test_a_sealed_file_shows_each_change(tmp_path: Path) -> None:
    path = tmp_path / "file"
    save_file(TENSORS, path, METADATA | {"sha256": safetensors_file.UNKNOWN})
    assert is_intact(path) is False
    seal(path)
    assert is_intact(path) is True
    whole = path.read_bytes()
    assert load(whole).keys() == TENSORS.keys()
    for place in range(len(whole)):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :])
        assert not is_intact(path), place
    path.write_bytes(whole + b"x")
    assert is_intact(path) is False


def test_a_file_without_a_checksum(tmp_path: Path) -> None:
    save_file(TENSORS, tmp_path / "file")
    assert is_intact(tmp_path / "file") is None
    (tmp_path / "file").write_bytes(b"")
    assert is_intact(tmp_path / "file") is None
