"""Where compiled kernels are kept, in installations and homes that cannot be written to."""

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

import idfslam
from idfslam.compute import cache_folder
from idfslam.compute.kernel_sources import fingerprint

PROJECT = """
import os, sys, tempfile
if "nothing" in sys.argv: tempfile.tempdir = "/dev/null/none"
if "memory" in sys.argv: tempfile._get_default_tempdir = lambda: open("/dev/null/none")
import idfslam
import numpy as np
from idfslam.compute.cache_folder import prepare_caches
from idfslam.geometry.projection import project
print(prepare_caches().folder, project.stats.cache_path if project._cache.cache_path else None, os.environ.get("MPLCONFIGDIR"))
"""

KERNELS = f"kernels-{fingerprint()}"


@pytest.fixture(scope="module")
def sealed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the package in which no cache can be written, by root either: a file lies where each __pycache__ would be made."""
    copy = tmp_path_factory.mktemp("sealed")
    shutil.copytree(Path(idfslam.__file__).parent, copy / "idfslam", ignore=shutil.ignore_patterns("__pycache__"))
    for folder in [path for path in (copy / "idfslam").rglob("*") if path.is_dir()] + [copy / "idfslam"]:
        (folder / "__pycache__").touch()
    return copy


def project(installation: Path, *words: str, **variables: str) -> tuple[list[str], list[str]]:
    """The words on stdout and the lines on stderr of a program that loads a kernel."""
    kept = {key: value for key, value in os.environ.items() if key not in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME", "MPLCONFIGDIR")}
    environment = kept | {"PYTHONPATH": str(installation)} | variables
    done = subprocess.run([sys.executable, "-c", PROJECT, *words], capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr
    return done.stdout.split(), done.stderr.splitlines()


@pytest.mark.slow
def test_an_installation_that_can_be_written_to_is_used() -> None:
    place, kernels, matplotlib = project(cache_folder.INSTALLATION.parent)[0]
    assert place == str(cache_folder.INSTALLATION / "__pycache__" / KERNELS)
    assert Path(kernels).parent == Path(place)
    assert matplotlib == "None"


@pytest.mark.slow
def test_else_the_users_cache_folder_without_a_word(sealed: Path, tmp_path: Path) -> None:
    words, lines = project(sealed, XDG_CACHE_HOME=str(tmp_path))
    assert words[0] == str(tmp_path / "idf-slam" / KERNELS)
    assert Path(words[1]).parent == Path(words[0])
    assert not lines


@pytest.mark.slow
def test_else_a_temporary_folder_with_one_line(sealed: Path, tmp_path: Path) -> None:
    words, lines = project(sealed, HOME="/dev/null/home", TMPDIR=str(tmp_path))
    folder = tmp_path / f"idf-slam-{os.getuid()}"
    assert words[0] == str(folder / KERNELS)
    assert Path(words[1]).parent == folder / KERNELS
    assert words[2] == str(folder / "matplotlib")
    assert folder.stat().st_mode & 0o777 == 0o700
    assert len(lines) == 1
    assert f"kept in the temporary folder {folder}; set NUMBA_CACHE_DIR" in lines[0]


@pytest.mark.slow
@pytest.mark.skipif(not os.access("/dev/shm", os.W_OK), reason="needs /dev/shm")
def test_else_a_folder_in_memory(sealed: Path) -> None:
    words, lines = project(sealed, "memory", HOME="/dev/null/home")
    assert words[0] == f"/dev/shm/idf-slam-{os.getuid()}/{KERNELS}"
    assert len(lines) == 1
    shutil.rmtree(words[0])


@pytest.mark.slow
def test_else_no_folder_with_one_line(sealed: Path) -> None:
    words, lines = project(sealed, "nothing", HOME="/dev/null/home")
    assert words[:2] == ["None", "None"]
    assert len(lines) == 1
    assert "kernels are compiled anew in every process" in lines[0]


@pytest.mark.slow
def test_the_users_variable_comes_first(sealed: Path, tmp_path: Path) -> None:
    words, lines = project(cache_folder.INSTALLATION.parent, NUMBA_CACHE_DIR=str(tmp_path))
    assert (words[0], lines) == (str(tmp_path / KERNELS), [])
    inherited = project(cache_folder.INSTALLATION.parent, NUMBA_CACHE_DIR=words[0])[0]  # the variable as this program has set it
    assert inherited[0] == words[0]
    words, lines = project(sealed, NUMBA_CACHE_DIR="/dev/null/kernels", XDG_CACHE_HOME=str(tmp_path))
    assert words[0] == str(tmp_path / "idf-slam" / KERNELS)
    assert lines == [f"NUMBA_CACHE_DIR=/dev/null/kernels cannot be written to: compiled kernels are kept in {tmp_path / 'idf-slam'}"]


def test_a_temporary_folder_of_another_user_is_not_used(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(cache_folder.tempfile, "tempdir", str(tmp_path))
    trap = tmp_path / f"idf-slam-{os.getuid()}"
    trap.mkdir()
    trap.chmod(0o777)  # all may write code into it, which Numba would run
    folder = cache_folder.temporary_folder.__wrapped__()
    assert folder is not None
    assert folder != trap
    assert folder.stat().st_mode & 0o777 == 0o700


def test_a_full_disk_is_used_only_with_kernels_on_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    full = shutil._ntuple_diskusage(10**9, 10**9, 0)  # type: ignore[attr-defined]
    monkeypatch.setattr(cache_folder.shutil, "disk_usage", lambda folder: full)
    assert not cache_folder.usable(tmp_path)
    (tmp_path / "kernel.nbi").touch()
    assert cache_folder.usable(tmp_path)


def test_kernels_of_other_sources_go_when_nothing_has_used_them_for_a_month(tmp_path: Path) -> None:
    used, recent, old, other = (tmp_path / name for name in ("kernels-1", "kernels-2", "kernels-3", "matplotlib"))
    days = {used: 40, recent: 20, old: 40, other: 40}
    for folder, age in days.items():
        folder.mkdir()
        (folder / "kernel.nbi").touch()
        os.utime(folder, (0, time.time() - age * 86400))
    cache_folder._remove_unused(used)
    assert [folder.exists() for folder in (used, recent, old, other)] == [True, True, False, True]
    assert time.time() - used.stat().st_mtime < 60


def test_of_many_folders_of_kernels_the_newest_stay(tmp_path: Path) -> None:
    folders = [tmp_path / f"kernels-{hours}" for hours in range(30)]
    for hours, folder in enumerate(folders):
        folder.mkdir()
        os.utime(folder, (0, time.time() - hours * 3600))
    cache_folder._remove_unused(folders[0])
    assert [folder.exists() for folder in folders] == [True] * 24 + [False] * 6  # 20, and those that were used within a day
