"""The results of a peer's program, in one file of numpy's."""

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class ProgramResult:
    """What a peer found, and what it needed."""

    poses: NDArray[np.float64]  # (N, 4, 4) T_wc, NaN: no pose
    seconds: float  # in the peer's own calls
    version: str
    peak_memory_mb: float  # [MiB] of its process
    vertices: NDArray[np.float64]  # (V, 3) [m], none without a surface
    faces: NDArray[np.int64]  # (F, 3)


def write_result(path: Path, result: ProgramResult) -> None:
    """Writes a result."""
    np.savez(path, **vars(result))


def read_result(path: Path) -> ProgramResult:
    """Reads what `write_result` wrote. Raises OSError, ValueError or KeyError for any other file."""
    with np.load(path, allow_pickle=False) as file:
        seconds, memory = float(file["seconds"]), float(file["peak_memory_mb"])
        return ProgramResult(file["poses"], seconds, str(file["version"]), memory, file["vertices"], file["faces"])


def peak_memory() -> float:
    """Peak memory [MiB] of this process so far; NaN on Windows, which does not report it."""
    if sys.platform == "win32":
        return float("nan")
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (2**20 if sys.platform == "darwin" else 2**10)
