"""What this machine has that needs no torch to be known: cores, memory, disk, the processor's name and abilities."""

import os
import platform
import re
import shutil
from pathlib import Path

MOST_THREADS = 8  # of one run: the networks are small
_CPUINFO, _MEMINFO = Path("/proc/cpuinfo"), Path("/proc/meminfo")


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def default_threads(workers: int = 1) -> int:
    """Threads of each of so many runs at once: its share of the cores, at most 8."""
    return max(1, min(cores() // workers, MOST_THREADS))


def processor() -> str:
    """The processor's name."""
    found = re.search(r"^model name\s*:\s*(.+)$", _read(_CPUINFO), re.MULTILINE)
    return found[1] if found else platform.processor() or platform.machine()


def instruction_sets() -> list[str]:
    """Those of AVX2, AVX512, AVX512-BF16 and AMX that the system reports; none where it reports nothing (not Linux)."""
    found = re.search(r"^flags\s*:\s*(.+)$", _read(_CPUINFO), re.MULTILINE)
    flags = set(found[1].split()) if found else set()
    names = {"avx2": "AVX2", "avx512f": "AVX512", "avx512_bf16": "AVX512-BF16", "amx_bf16": "AMX-BF16"}
    return [name for flag, name in names.items() if flag in flags]


def memory() -> tuple[int, int] | None:
    """Bytes of memory, all and available; None where the system does not tell (not Linux)."""
    found = dict(re.findall(r"^(MemTotal|MemAvailable):\s+(\d+) kB$", _read(_MEMINFO), re.MULTILINE))
    return (int(found["MemTotal"]) * 1024, int(found["MemAvailable"]) * 1024) if len(found) == 2 else None


def free_disk(folder: Path) -> int:
    """Bytes free where `folder` is, or would be made."""
    place = folder.absolute()
    while not place.exists():
        place = place.parent
    return shutil.disk_usage(place).free


def _read(path: Path) -> str:
    return path.read_text(encoding="utf-8", errors="replace") if path.is_file() else ""
