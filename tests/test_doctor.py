"""What `doctor` finds, and what it asks for."""

import json
import os
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from idfslam.cli import command_line, doctor
from idfslam.cli.doctor import examine, extras
from idfslam.compute import host
from idfslam.compute.cache_folder import KernelCache
from idfslam.config import FAST, PAPER
from idfslam.errors import pip_install


def test_this_machine_is_told_as_json(capsys: pytest.CaptureFixture[str]) -> None:
    command_line.main(["doctor", "--json", "--device", "cpu"])
    told = json.loads(capsys.readouterr().out)
    assert told["ready"] is True
    found = told["found"]
    assert found["torch"]["version"] == torch.__version__
    assert found["processor"]["cores"] == host.cores() >= 1
    assert found["weights"] == {"path": "shipped", "loaded": True}
    assert found["used"]["device"] == "cpu"
    assert found["used"]["kernels"] == "numba, fused"
    assert found["numba_cache"]["writable"]
    assert found["numba_cache"]["folder"] == os.environ["NUMBA_CACHE_DIR"]


def test_the_table_ends_with_ready(capsys: pytest.CaptureFixture[str]) -> None:
    command_line.main(["doctor", "--device", "cpu"])
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("idf-slam")
    assert lines[-1] == "ready"


def test_kernels_of_the_paper_preset_are_torch() -> None:
    assert examine(replace(PAPER, device="cpu")).found["used"]["kernels"] == "torch"


def test_it_says_what_was_never_tried_on_a_gpu(capsys: pytest.CaptureFixture[str]) -> None:
    command_line.main(["doctor", "--device", "cpu"])
    said = capsys.readouterr().out
    for part in ("preset fast", "preset paper", "pretraining"):
        (line,) = [line for line in said.splitlines() if line.startswith(part)]
        assert "never tried" in line


def test_a_cuda_build_without_a_gpu_is_a_fault_where_a_gpu_would_be_used(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.version, "cuda", "12.4")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert examine(FAST).ready
    assert ["check the driver" in line for line in examine(PAPER).advice] == [True]


@pytest.mark.skipif(torch.cuda.is_available(), reason="tells of a GPU that is not there")
def test_a_missing_gpu_is_told_and_ends_with_1(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        command_line.main(["doctor", "--device", "cuda"])
    assert caught.value.code == 1
    said = capsys.readouterr().out
    assert "to do: --device cuda: this torch finds no CUDA device" in said
    assert said.splitlines()[-1] == "not ready"


def test_what_is_scarce_or_missing_is_advised(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(host, "memory", lambda: (8 * 2**30, 2**30))
    monkeypatch.setattr(host, "free_disk", lambda folder: 2**28)
    monkeypatch.setattr(doctor, "prepare_caches", lambda: KernelCache(None, "nowhere; set NUMBA_CACHE_DIR"))
    weights = replace(FAST.tracker, weights=tmp_path / "none.safetensors")
    advice = examine(replace(FAST, device="cpu", tracker=weights), tmp_path).advice
    assert len(advice) == 4
    assert advice[0].startswith("1.0 GiB of memory are available")
    assert advice[1].startswith("0.25 GiB are free at")
    assert "set NUMBA_CACHE_DIR" in advice[2]
    assert "none.safetensors" in advice[3]


def test_extras_are_those_that_the_package_declares(monkeypatch: pytest.MonkeyPatch) -> None:
    declared = [
        "numpy>=1",
        "idf-slam[x]; extra == 'all'",
        "no-such-package>=3; extra == 'x'",
        'pytest>=8; python_version < "4" and extra == "x"',
    ]
    monkeypatch.setattr(doctor, "requires", lambda name: declared)
    found = extras()
    assert list(found) == ["x"]
    assert found["x"]["missing"] == ["no-such-package"]
    assert found["x"]["installed"] == {"pytest": pytest.__version__}
    assert found["x"]["install"] == pip_install("pytest", "no-such-package")


def test_machine_of_a_linux_system(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "cpu").write_text("model name\t: Some CPU @ 3 GHz\nflags\t\t: fpu avx2 avx512f amx_bf16\n")
    (tmp_path / "memory").write_text("MemTotal:       2000 kB\nMemFree:  1 kB\nMemAvailable:    1000 kB\n")
    monkeypatch.setattr(host, "_CPUINFO", tmp_path / "cpu")
    monkeypatch.setattr(host, "_MEMINFO", tmp_path / "memory")
    assert host.processor() == "Some CPU @ 3 GHz"
    assert host.instruction_sets() == ["AVX2", "AVX512", "AMX-BF16"]
    assert host.memory() == (2_048_000, 1_024_000)
    monkeypatch.setattr(host, "_MEMINFO", tmp_path / "none")
    assert host.memory() is None
    assert host.free_disk(tmp_path / "not" / "there") > 0
