"""The machine without torch: cores, memory, disk, the processor's name and its instruction sets."""

import os
import platform
import re
import shutil
from pathlib import Path

MOST_THREADS = 8  # threads of one run at most. More: no faster, since the networks are small. Chosen by hand
_CPUINFO, _MEMINFO = Path("/proc/cpuinfo"), Path("/proc/meminfo")


def cores() -> int:
    """The number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def default_threads(workers: int = 1) -> int:
    """The number of threads of each of `workers` concurrent runs: its share of the cores, at most 8."""
    return max(1, min(cores() // workers, MOST_THREADS))


def processor() -> str:
    """The processor's name."""
    model = re.search(r"^model name\s*:\s*(.+)$", _read(_CPUINFO), re.MULTILINE)
    return model[1] if model else platform.processor() or platform.machine()


def instruction_sets() -> list[str]:
    """The reported instruction sets among AVX2, AVX512, AVX512-BF16 and AMX; empty if the system reports none (not Linux)."""
    line = re.search(r"^flags\s*:\s*(.+)$", _read(_CPUINFO), re.MULTILINE)
    flags = set(line[1].split()) if line else set()
    names = {"avx2": "AVX2", "avx512f": "AVX512", "avx512_bf16": "AVX512-BF16", "amx_bf16": "AMX-BF16"}
    return [name for flag, name in names.items() if flag in flags]


def memory() -> tuple[int, int] | None:
    """Total and available memory [bytes]; None if the system does not report it (not Linux)."""
    sizes = dict(re.findall(r"^(MemTotal|MemAvailable):\s+(\d+) kB$", _read(_MEMINFO), re.MULTILINE))
    return (int(sizes["MemTotal"]) * 1024, int(sizes["MemAvailable"]) * 1024) if len(sizes) == 2 else None


def free_disk(folder: Path) -> int:
    """Free space [bytes] on the disk of a folder, which need not exist yet."""
    existing = folder.absolute()
    while not existing.exists():
        existing = existing.parent
    return shutil.disk_usage(existing).free


def _read(path: Path) -> str:
    return path.read_text(encoding="utf-8", errors="replace") if path.is_file() else ""
