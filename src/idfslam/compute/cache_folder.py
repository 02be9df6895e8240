"""The folder in which compiled kernels are kept between runs, and the folders of other libraries that need one.

Numba keeps kernels beside the source files, or in the user's cache folder. In a container neither may be writable, and Numba then refuses
to compile at all. `prepare_caches` finds a place that can be written to, before Numba is imported:

1. NUMBA_CACHE_DIR, if the user has set it,
2. the installation, in `__pycache__`,
3. the user's cache folder: `$XDG_CACHE_HOME/idf-slam` or `~/.cache/idf-slam`, and their like on Windows and macOS,
4. a folder of this user in the temporary folder (TMPDIR), or in memory (/dev/shm),
5. none: kernels are compiled in every process.

There, they are in a folder that is named by their sources (`compute/kernel_sources.py`), so that none is older than a constant in it.

Matplotlib and torch are given a folder too if the user's cache folder cannot be written to.
"""

import logging
import os
import shutil
import sys
import tempfile
import time
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from idfslam.compute.kernel_sources import INSTALLATION, fingerprint

log = logging.getLogger(__name__)

VARIABLE = "NUMBA_CACHE_DIR"
_NAME = "kernels-"  # and a fingerprint
_DAY = 24 * 3600.0  # [s]: a fact, not a choice
_KEPT = 30 * _DAY  # [s] kernels of other sources are removed when no process has used them for so long; larger: the disk fills
_MANY = 20  # folders of kernels, beyond which a day is enough: who changes kernels makes some each day; more: the disk fills
_ROOM = 2**26  # [bytes] free space that an empty folder needs; all kernels take 12 MB. Larger: fuller disks are passed over
_IN_MEMORY = "/dev/shm"  # a folder in memory, which Linux has even where the disk is read-only
_TORCH = "TORCHINDUCTOR_CACHE_DIR"
_OTHERS = {"MPLCONFIGDIR": "matplotlib", _TORCH: "torch", "TRITON_CACHE_DIR": "triton"}


@dataclass(frozen=True)
class KernelCache:
    """Where compiled kernels are kept."""

    folder: Path | None  # those of the present sources; None: nowhere
    problem: str | None = None  # why they are not kept where the user would expect them


@cache
def prepare_caches() -> KernelCache:
    """Finds the folders and tells the libraries by their environment variables, so that other processes of the run use them too.

    Logs one warning if kernels go to a temporary folder, or nowhere. Later calls return what the first one found.
    """
    found = _kernel_cache()
    if found.problem:
        log.warning(found.problem)
    if found.folder is None:
        _compile_without_cache()
    else:
        _set_numba_folder(found.folder)
        _remove_unused(found.folder)
    _prepare_others()
    return found


def kernels_on_disk() -> bool:
    """Whether compiled kernels are in the cache. It looks for one that is compiled with the others."""
    folder = prepare_caches().folder
    return folder is not None and any(folder.rglob("numba_field.learn-*.nbi"))


def _kernel_cache() -> KernelCache:
    is_set = os.environ.get(VARIABLE)
    if is_set and usable(folder := _folder_in(_place(Path(is_set)))):
        return KernelCache(folder)
    problem = f"{VARIABLE}={is_set} cannot be written to" if is_set else None
    for place in (INSTALLATION / "__pycache__", user_folder()):
        if place is not None and usable(folder := _folder_in(place)):
            return KernelCache(folder, problem and f"{problem}: compiled kernels are kept in {place}")
    problem = problem or "neither the installation nor a cache folder of yours can be written to"
    temporary = temporary_folder()
    if temporary is not None:
        advice = f"set {VARIABLE} to keep them elsewhere"
        text = f"{problem}: compiled kernels are kept in the temporary folder {temporary}; {advice}"
        return KernelCache(_folder_in(temporary), text)
    advice = f"set {VARIABLE} to a folder that can be written to"
    return KernelCache(None, f"{problem}, nor a temporary folder: kernels are compiled anew in every process, for about a minute; {advice}")


def _folder_in(place: Path) -> Path:
    return place / (_NAME + fingerprint())


def _place(folder: Path) -> Path:
    """The place that the user has set, also if it was this program that set the variable, in the process that started this one."""
    return folder.parent if folder.name.startswith(_NAME) else folder


def user_folder() -> Path | None:
    """This program's folder among the user's caches; None if the user has no home. It need not exist."""
    if sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA", ""))
    elif sys.platform == "darwin":
        base = Path(os.path.expanduser("~"), "Library", "Caches")
    else:
        base = Path(os.environ.get("XDG_CACHE_HOME") or Path(os.path.expanduser("~"), ".cache"))
    home_exists = Path(os.path.expanduser("~")).is_dir() or bool(os.environ.get("XDG_CACHE_HOME"))
    return base / "idf-slam" if base.is_absolute() and home_exists else None


@cache
def temporary_folder() -> Path | None:
    """A folder of this user alone in the temporary folder, the same in every process; None if there is none that can be written to.

    Numba runs what lies in its cache. A folder that another user owns or may write to is therefore not used.
    """
    try:
        base = tempfile.gettempdir()
    except OSError:  # no folder for temporary files at all: then this one is theirs, of other libraries too
        base = _IN_MEMORY
        os.environ["TMPDIR"] = base
    try:
        user = os.getuid() if hasattr(os, "getuid") else "cache"
        folder = Path(base, f"idf-slam-{user}")
        folder.mkdir(mode=0o700, exist_ok=True)
        status = folder.lstat()
        if hasattr(os, "getuid") and (folder.is_symlink() or status.st_uid != os.getuid() or status.st_mode & 0o022):
            folder = Path(tempfile.mkdtemp(prefix="idf-slam-", dir=base))
    except OSError:
        return None
    return folder if usable(folder) else None


def usable(folder: Path) -> bool:
    """Whether files can be written to the folder, which is made if need be, and its disk has room for kernels or holds them already.

    Folders in it may belong to another user, who ran the program first.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
        writable = all(os.access(inner, os.W_OK) for inner in folder.iterdir() if inner.is_dir())
        return writable and (shutil.disk_usage(folder).free >= _ROOM or any(folder.rglob("*.nbi")))
    except OSError:
        return False


def _set_numba_folder(folder: Path) -> None:
    os.environ[VARIABLE] = str(folder)
    if "numba" in sys.modules:  # it reads the variable when it is imported
        import numba

        numba.config.CACHE_DIR = str(folder)  # type: ignore[attr-defined]


def _remove_unused(folder: Path) -> None:
    """Marks the folder as used now, and removes those beside it that no process has used for long."""
    now = time.time()
    with suppress(OSError):  # another process removes them too, or they belong to another user
        os.utime(folder)
        ages = sorted((now - other.stat().st_mtime, other) for other in folder.parent.glob(f"{_NAME}*"))
        for number, (age, other) in enumerate(ages):
            if age > (_KEPT if number < _MANY else _DAY):
                shutil.rmtree(other, ignore_errors=True)


def _compile_without_cache() -> None:
    """Has Numba ignore `cache=True`, with which it would raise an error for lack of a folder."""
    os.environ.pop(VARIABLE, None)
    from numba.core.dispatcher import Dispatcher

    Dispatcher.enable_caching = lambda self: None  # type: ignore[method-assign]


def _prepare_others() -> None:
    """Gives other libraries a temporary folder each if there is no home to write to. Some would warn, others raise an error."""
    home = user_folder()
    if home is not None and os.access(_existing(home), os.W_OK):
        return
    temporary = temporary_folder()
    if temporary is None:
        os.environ.setdefault(_TORCH, os.curdir)  # a folder that exists: torch makes it when an optimiser is first created
        return
    for variable, name in _OTHERS.items():
        os.environ.setdefault(variable, str(temporary / name))


def _existing(folder: Path) -> Path:
    """The nearest folder above that exists."""
    return next(place for place in (folder, *folder.parents) if place.exists())
