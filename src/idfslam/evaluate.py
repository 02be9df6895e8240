"""A result folder against ground truth: trajectory and mesh, as numbers, a table, JSON and a picture."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from idfslam import results
from idfslam.errors import ResultError
from idfslam.evaluation.mesh_error import MeshError, mesh_error
from idfslam.evaluation.trajectory_error import (
    AbsoluteTrajectoryError,
    RelativePoseError,
    absolute_trajectory_error,
    matched_ground_truth,
    relative_pose_error,
)
from idfslam.geometry.trajectory import load_tum
from idfslam.pictures import draw_trajectory
from idfslam.run import open_source

EVALUATION, PICTURE = "evaluation.json", "evaluation.png"


@dataclass(frozen=True, eq=False)
class Evaluation:
    """The errors of a run; without a true mesh those of the trajectory alone."""

    frames: int  # of the run
    ate: AbsoluteTrajectoryError
    rpe: RelativePoseError | None  # None: no two frames in a row have ground truth
    mesh: MeshError | None

    def values(self) -> dict[str, Any]:
        """As in evaluation.json: [m], [degrees], shares in 0..1; every value of the mesh under the protocol named there."""
        values: dict[str, Any] = {"frames": self.frames, "frames_with_truth": len(self.ate.frames), "ate_m": asdict(self.ate.translation)}
        if self.rpe is not None:
            values |= {"rpe_delta_frames": self.rpe.delta, "rpe_translation_m": asdict(self.rpe.translation)}
            values |= {"rpe_rotation_deg": asdict(self.rpe.rotation)}
        return values if self.mesh is None else values | {"mesh": asdict(self.mesh)}


def evaluate(folder: Path, *, gt: Path | None = None, gt_mesh: Path | None = None, protocol: str = "seen") -> Evaluation:
    """Errors of the results in `folder`; writes evaluation.json and evaluation.png there.

    gt: TUM trajectory, matched by time stamp; without it the recording's own ground truth, frame by frame. gt_mesh: in metres and in the
    frame of the ground truth; without it a synthetic room's own surface, and for other recordings no mesh is evaluated.
    Raises ResultError where results or ground truth are missing.
    """
    estimate = load_tum(results.existing(folder, results.TRAJECTORY))
    truth = _recorded_truth(folder, len(estimate)) if gt is None else matched_ground_truth(estimate, load_tum(gt))
    ate = absolute_trajectory_error(estimate.poses, truth)
    surface = _recorded_surface(folder) if gt_mesh is None else _load_mesh(gt_mesh)
    mesh = None
    if surface is not None:
        reconstruction = _load_mesh(results.existing(folder, results.MESH))
        camera = results.read_keyframes(folder).camera
        mesh = mesh_error(reconstruction, surface, poses=truth, camera=camera, protocol=protocol, T_gt_est=ate.T_gt_est)
    evaluation = Evaluation(len(estimate), ate, relative_pose_error(estimate.poses, truth), mesh)
    results.write_json(folder / EVALUATION, evaluation.values())
    with results.replacing(folder / PICTURE) as part:
        draw_trajectory(part, estimate.poses, truth)
    return evaluation


def _recorded_truth(folder: Path, frames: int) -> NDArray[np.float64]:
    """(N, 4, 4) of the frames of the run."""
    _, source = results.read_config(folder)
    truth = None if source is None else open_source(source).ground_truth
    if truth is None:
        raise ResultError(f"{folder}: its recording has no ground truth; give one in TUM format with --gt")
    if len(truth) < frames:
        raise ResultError(f"{folder}: has {frames} frames, its recording now {len(truth)}; run again, or give the ground truth with --gt")
    return truth[:frames]


def _recorded_surface(folder: Path) -> trimesh.Trimesh | None:
    """The true surface, where the recording knows it (a synthetic room)."""
    _, source = results.read_config(folder)
    return None if source is None or not source.path.startswith("synthetic") else open_source(source).surface()


def _load_mesh(path: Path) -> trimesh.Trimesh:
    if not path.is_file():
        raise ResultError(f"{path}: no such file; expected a triangle mesh in metres (.ply, .obj, .off, .stl, .glb)")
    try:
        mesh = trimesh.load_mesh(path, process=False)
    except (ValueError, IndexError, KeyError, NotImplementedError) as error:
        raise ResultError(f"{path}: cannot be read as a mesh ({error}); expected .ply, .obj, .off, .stl or .glb") from error
    if not isinstance(mesh, trimesh.Trimesh) or not len(mesh.faces):
        raise ResultError(f"{path}: holds no triangles; expected a triangle mesh in metres")
    return mesh
