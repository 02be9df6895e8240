"""What all peers have in common: other systems, which are called where they are installed and never depended on."""

import subprocess
import sys
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import numpy as np
import trimesh
from numpy.typing import NDArray

from idfslam.datasets import Dataset
from idfslam.errors import IdfSlamError


class PeerError(IdfSlamError):
    """A peer that crashed, lost the camera for good, or is not installed; the message is one line."""


@dataclass(frozen=True)
class PeerJob:
    """What a peer is to do."""

    recording: Dataset
    folder: Path  # for its own files; deleted afterwards
    seed: int = 0
    python: str = sys.executable  # of the environment that has the peer's package
    poses: NDArray[np.float64] | None = None  # (N, 4, 4) T_wc of our run, for a peer that takes them


@dataclass(frozen=True, eq=False)
class PeerRun:
    """What a peer has found."""

    poses: NDArray[np.float64]  # (N, 4, 4) T_wc, NaN: no pose
    seconds: float  # in the peer's own calls
    version: str
    peak_memory_mb: float | None = None  # [MiB] of its process; None: unknown
    mesh: trimesh.Trimesh = field(default_factory=trimesh.Trimesh)  # empty: it has no surface


class Peer(ABC):
    """A system to compare with."""

    name: ClassVar[str]  # for --against
    about: ClassVar[str]  # what is run, in a sentence, with its licence
    takes_poses: ClassVar[bool] = False  # whether it takes the poses of our run, so that its trajectory is none of its own

    @abstractmethod
    def missing(self, python: str) -> str | None:
        """How to install it, in a few words; None if it is there."""

    @abstractmethod
    def run(self, job: PeerJob) -> PeerRun:
        """Runs it. Raises PeerError."""


def has_package(python: str, package: str) -> bool:
    """Whether a Python finds a package. Raises PeerError if that is no Python that can be run."""
    command = [python, "-c", f"import importlib.util, sys; sys.exit(importlib.util.find_spec({package!r}) is None)"]
    try:
        return subprocess.run(command, capture_output=True, check=False).returncode == 0
    except OSError as error:
        raise PeerError(f"{python}: cannot be run ({error.strerror}), expected the Python of an environment") from error
