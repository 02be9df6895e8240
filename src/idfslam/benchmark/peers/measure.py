"""Runs one peer on one recording and measures it with the evaluator of our own runs, as a process of its own.

    python -m idfslam.benchmark.peers.measure PEER RECORDING --out DIR [--frames N] [--seed S] [--python PYTHON] [--run DIR] ...

DIR gets trajectory.txt, mesh.ply if the peer has a surface, evaluation.json where the truth is known, and peer.json.
"""

import argparse
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from idfslam.benchmark.peers.choice import find_peer
from idfslam.benchmark.peers.peer import PeerError, PeerJob, PeerRun
from idfslam.datasets import Dataset, open_recording
from idfslam.errors import IdfSlamError
from idfslam.evaluation.depth_range import depth_range
from idfslam.evaluation.evaluate import evaluate, load_mesh
from idfslam.evaluation.files import FILES as EVALUATION_FILES
from idfslam.geometry.trajectory import Trajectory, save_tum
from idfslam.runs import result_folder
from idfslam.runs.finished_run import FinishedRun
from idfslam.storage import output_folder
from idfslam.storage.ledger import Ledger

MEASURED = "peer.json"
_FILES = (result_folder.TRAJECTORY, result_folder.MESH, MEASURED, *EVALUATION_FILES)


def measure(
    name: str,
    recording: Dataset,
    folder: Path,
    *,
    seed: int = 0,
    python: str = sys.executable,
    run: Path | None = None,
    gt_mesh: Path | None = None,
    mesh: bool = True,
) -> dict[str, Any]:
    """Runs a peer, writes its results to `folder` and returns the values of peer.json.

    run: the result folder of our own run, for a peer that takes its poses. gt_mesh: the true surface; None: the recording's own.
    mesh: whether the surface is measured. Raises PeerError, and ResultError for a folder that holds another's files.
    """
    peer = find_peer(name)
    if how := peer.missing(python):
        raise PeerError(how)
    poses = FinishedRun(run).trajectory.poses if peer.takes_poses and run is not None else None
    output_folder.refuse_foreign(folder)
    with output_folder.locked(folder), tempfile.TemporaryDirectory(prefix="idf-slam-peer-") as own:
        ledger = Ledger(folder)
        ledger.refuse_foreign(_FILES)
        ledger.remove(ledger.names)
        found = peer.run(PeerJob(recording, Path(own), seed, python, poses))
        _write_results(ledger, recording, found)
        values = _measured(recording, found) | _errors(folder, recording, found, gt_mesh, poses_are_its_own=not peer.takes_poses, mesh=mesh)
        Ledger(folder).write_json(MEASURED, values)  # read again: the evaluation has entered its own files
    return values


def _write_results(ledger: Ledger, recording: Dataset, found: PeerRun) -> None:
    tracked = Trajectory.of_known(recording.timestamps, found.poses)
    if not len(tracked):
        raise PeerError("it gave no frame a pose")
    with ledger.replacing(result_folder.TRAJECTORY) as part:
        save_tum(part, tracked)
    if len(found.mesh.faces):
        with ledger.replacing(result_folder.MESH) as part:
            found.mesh.export(part, file_type="ply")


def _measured(recording: Dataset, found: PeerRun) -> dict[str, Any]:
    lost = len(recording) - int(np.isfinite(found.poses).all((1, 2)).sum())
    speed = {"seconds": found.seconds, "frames_per_second": len(recording) / max(found.seconds, 1e-9)}
    return {"version": found.version, "frames": len(recording), **speed, "lost_frames": lost, "peak_memory_mb": found.peak_memory_mb}


def _errors(
    folder: Path, recording: Dataset, found: PeerRun, gt_mesh: Path | None, *, poses_are_its_own: bool, mesh: bool
) -> dict[str, Any]:
    """The errors by the evaluator of our own runs; empty for a recording without truth."""
    truth = recording.ground_truth
    if truth is None or not np.isfinite(truth).all((1, 2)).any():
        return {}
    surface = None
    if mesh and len(found.mesh.faces):
        surface = recording.surface() if gt_mesh is None else load_mesh(gt_mesh)
    evaluation = evaluate(
        folder,
        gt_trajectory=Trajectory.of_known(recording.timestamps, truth),
        gt_mesh=surface,
        camera=recording.camera,
        sensor_range=None if surface is None else depth_range(recording),
    )
    values = {"ate_m": evaluation.ate.translation.rmse} if poses_are_its_own else {}
    if evaluation.mesh is None:
        return values
    m = evaluation.mesh
    errors = {"accuracy_m": m.accuracy, "completion_m": m.completion, "completion_ratio": m.completion_ratio}
    return values | errors | {"precision": m.precision, "f1": m.f1, "normal_angle": m.normal_angle}


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("peer")
    parser.add_argument("recording")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--frames", type=int)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--python", default=sys.executable)
    parser.add_argument("--run", type=Path)
    parser.add_argument("--gt-mesh", type=Path)
    parser.add_argument("--no-mesh", dest="mesh", action="store_false")
    flags = parser.parse_args(arguments)
    try:
        recording = open_recording(flags.recording, frames=flags.frames)
        options: dict[str, Any] = {
            "seed": flags.seed,
            "python": flags.python,
            "run": flags.run,
            "gt_mesh": flags.gt_mesh,
            "mesh": flags.mesh,
        }
        measure(flags.peer, recording, flags.out, **options)
    except IdfSlamError as error:
        print(f"error: {error}", file=sys.stderr)
        raise SystemExit(1) from None


if __name__ == "__main__":
    main()
