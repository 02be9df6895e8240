"""The folder in which compiled kernels are kept between runs, and the folders of other libraries that need one.

Numba keeps kernels beside the source files, or in the user's cache folder. In a container neither may be writable, and Numba then refuses
to compile at all. `prepare_caches` finds a folder that can be written to, before Numba is imported:

1. NUMBA_CACHE_DIR, if the user has set it,
2. the installation,
3. the user's cache folder: `$XDG_CACHE_HOME/idf-slam` or `~/.cache/idf-slam`, and their like on Windows and macOS,
4. a folder of this user in the temporary folder (TMPDIR), or in memory (/dev/shm),
5. none: kernels are compiled in every process.

Matplotlib and torch are given a folder too if the user's cache folder cannot be written to.
"""

import logging
import os
import shutil
import sys
import tempfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path

log = logging.getLogger(__name__)

VARIABLE = "NUMBA_CACHE_DIR"
INSTALLATION = Path(__file__).parents[1]
_ROOM = 2**26  # [bytes] free space that an empty folder needs; all kernels take 12 MB. Larger: fuller disks are passed over
_IN_MEMORY = "/dev/shm"  # a folder in memory, which Linux has even where the disk is read-only
_TORCH = "TORCHINDUCTOR_CACHE_DIR"
_OTHERS = {"MPLCONFIGDIR": "matplotlib", _TORCH: "torch", "TRITON_CACHE_DIR": "triton"}


@dataclass(frozen=True)
class KernelCache:
    """Where compiled kernels are kept."""

    folder: Path | None  # None: nowhere
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
    elif found.folder != INSTALLATION:
        _set_numba_folder(found.folder)
    _prepare_others()
    return found


def kernels_on_disk() -> bool:
    """Whether compiled kernels are in the cache. It looks for one that is compiled with the others, later than its source was written."""
    folder, source = prepare_caches().folder, INSTALLATION / "mapping" / "kernels" / "numba_field.py"
    if folder is None or not source.exists():
        return False
    return any(index.stat().st_mtime >= source.stat().st_mtime for index in folder.rglob("numba_field.learn-*.nbi"))


def _kernel_cache() -> KernelCache:
    is_set = os.environ.get(VARIABLE)
    if is_set and usable(Path(is_set)):
        return KernelCache(Path(is_set))
    problem = f"{VARIABLE}={is_set} cannot be written to" if is_set else None
    for folder in (INSTALLATION if _installation_usable() else None, user_folder()):
        if folder is not None and (folder == INSTALLATION or usable(folder)):
            return KernelCache(folder, problem and f"{problem}: compiled kernels are kept in {folder}")
    problem = problem or "neither the installation nor a cache folder of yours can be written to"
    temporary = temporary_folder()
    if temporary is not None:
        advice = f"set {VARIABLE} to keep them elsewhere"
        return KernelCache(temporary, f"{problem}: compiled kernels are kept in the temporary folder {temporary}; {advice}")
    advice = f"set {VARIABLE} to a folder that can be written to"
    return KernelCache(None, f"{problem}, nor a temporary folder: kernels are compiled anew in every process, for about a minute; {advice}")


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
    """Whether files can be written to the folder, which is made if need be, and its disk has room for kernels or holds them already."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
        return shutil.disk_usage(folder).free >= _ROOM or any(folder.rglob("*.nbi"))
    except OSError:
        return False


def _installation_usable() -> bool:
    """Whether Numba can write beside each source file. Some folders may belong to another user, who ran the program first."""
    caches = (Path(folder, "__pycache__") for folder, _, files in os.walk(INSTALLATION) if "__init__.py" in files)
    written = all(os.access(folder if folder.exists() else folder.parent, os.W_OK) for folder in caches)
    return written and usable(INSTALLATION / "__pycache__")


def _set_numba_folder(folder: Path) -> None:
    os.environ[VARIABLE] = str(folder)
    if "numba" in sys.modules:  # it reads the variable when it is imported
        import numba

        numba.config.CACHE_DIR = str(folder)  # type: ignore[attr-defined]


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
