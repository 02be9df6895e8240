"""Runs the peers beside our own runs: after each seed of ours, on the same frames and cores."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from idfslam.batch.executor import Executor
from idfslam.batch.recordings import RecordingSpec
from idfslam.benchmark.peers.choice import PEERS, chosen
from idfslam.benchmark.peers.measure import MEASURED
from idfslam.benchmark.processes import BenchError, frames_flag, run_module
from idfslam.runs.metrics import headline
from idfslam.storage.json_file import read_json


class PeerRuns:
    """The peers of a benchmark."""

    def __init__(self, words: Sequence[str]) -> None:
        """words: NAME or NAME=PYTHON. Raises ConfigError for unknown names and Pythons."""
        self._pythons = chosen(words)
        self.names = list(self._pythons)
        found = {name: PEERS[name].missing(self._pythons[name]) for name in self.names}
        self.missing = {name: how for name, how in found.items() if how is not None}
        """How to install each peer that is not there."""
        self.borrowing = [name for name in self.names if PEERS[name].takes_poses]
        """Those that take the poses of our runs."""

    def described(self) -> dict[str, dict[str, Any]]:
        """What each peer is, for bench.json."""
        return {
            name: {"about": PEERS[name].about, "own_poses": not PEERS[name].takes_poses, "missing": self.missing.get(name)}
            for name in self.names
        }

    def folders(self, spec: RecordingSpec, seed: int) -> list[str]:
        """The names of the result folders of a seed."""
        return [f"{spec.name}-{name}-{seed}" for name in self.names if name not in self.missing]

    def run(
        self, executor: Executor, spec: RecordingSpec, seed: int, *, folder: Path, mesh: bool, report: Callable[[str], None]
    ) -> dict[str, dict[str, Any]]:
        """Runs all that are installed, one after the other. Returns the measured values of each, or the reason of its failure."""
        present = [name for name in self.names if name not in self.missing]
        return {name: self._run(executor, spec, seed, name, folder=folder, mesh=mesh, report=report) for name in present}

    def _run(
        self, executor: Executor, spec: RecordingSpec, seed: int, name: str, *, folder: Path, mesh: bool, report: Callable[[str], None]
    ) -> dict[str, Any]:
        out = folder / f"{spec.name}-{name}-{seed}"
        words = [name, spec.path, "--out", str(out), "--seed", str(seed), "--python", self._pythons[name], *frames_flag(spec)]
        words += ["--run", str(folder / f"{spec.name}-{seed}")] if PEERS[name].takes_poses else []
        words += ([] if mesh else ["--no-mesh"]) + ([] if spec.gt_mesh is None else ["--gt-mesh", str(spec.gt_mesh)])
        try:
            run_module(executor, "idfslam.benchmark.peers.measure", *words)
            measured: dict[str, Any] = read_json(out / MEASURED, error=BenchError, expected="the measured values of a peer")
        except BenchError as error:
            report(f"{spec.name}, {name}, seed {seed}: failed: {error}")
            return {"seed": seed, "failed": str(error)}
        line = headline(measured["frames"], measured["frames_per_second"], measured.get("ate_m"))
        report(f"{spec.name}, {name}, seed {seed}: {line}")
        return {"seed": seed} | {key: value for key, value in measured.items() if value is not None}
