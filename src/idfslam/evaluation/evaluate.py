"""The evaluation of a result folder against ground truth: what `idf-slam eval` does."""

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from idfslam.errors import ResultError
from idfslam.evaluation.depth_range import DepthRange
from idfslam.evaluation.mesh_error import SAMPLES, VIEWS, mesh_error, protocol_named
from idfslam.evaluation.summary import Evaluation, plot_error, plot_trajectory, save_json
from idfslam.evaluation.trajectory_error import absolute_trajectory_error, matched_ground_truth, relative_pose_error
from idfslam.geometry.camera import Camera
from idfslam.geometry.trajectory import Trajectory, is_rotation_determined, load_tum

log = logging.getLogger(__name__)


def evaluate(
    folder: Path,
    *,
    gt_trajectory: Trajectory,
    gt_mesh: trimesh.Trimesh | None = None,
    camera: Camera | None = None,
    readings: DepthRange | None = None,
    protocol: str = "seen",
    tolerance: float = 0.02,
    keyframes: NDArray[np.int64] | None = None,
    samples: int = SAMPLES,
    views: int = VIEWS,
    seed: int = 0,
) -> Evaluation:
    """Measures FOLDER/trajectory.txt and, where a true mesh is given, FOLDER/mesh.ply; writes evaluation.json, trajectory.png, error.png.

    The mesh is moved into the truth's frame by the trajectories' alignment; the true mesh must lie in the true trajectory's frame. Stamps
    within `tolerance` [s] belong together. Camera and `readings` (the depths that the recording holds) tell what it could see. `keyframes`
    (K,) are marked in the plot. `samples`: points on each surface; `views`: of depth L1.
    A mesh of which nothing counts under the protocol is reported, and left out.
    Raises `ResultError` for missing or empty files, `TrajectoryError` for trajectories that cannot be compared, `ConfigError` for an
    unknown protocol.
    """
    protocol_named(protocol)
    estimate = load_result_trajectory(folder)
    truth = matched_ground_truth(estimate, gt_trajectory, tolerance=tolerance)
    result = evaluate_poses(estimate.poses, truth)
    ate = result.ate
    if gt_mesh is not None:
        if camera is None:
            raise ResultError("a true mesh is given but no camera; give size, focal lengths and principal point, they tell what was seen")
        if not is_rotation_determined(truth[ate.frames, :3, 3]):
            log.warning("the true camera centres lie on one line: the alignment that moves the mesh is not determined")
        reconstruction = load_mesh(folder / "mesh.ply")
        try:
            mesh = mesh_error(
                reconstruction,
                gt_mesh,
                poses=truth,
                camera=camera,
                protocol=protocol,
                T_gt_est=ate.T_gt_est,
                readings=readings,
                samples=samples,
                views=views,
                seed=seed,
            )
            result = replace(result, mesh=mesh)
        except ResultError as error:  # such as a trajectory so wrong that nothing of the mesh is seen: its error is still worth knowing
            log.warning("%s: the mesh is not evaluated: %s", folder, error)
    save_json(folder / "evaluation.json", result)
    plot_trajectory(folder / "trajectory.png", estimate.poses, truth, T_gt_est=ate.T_gt_est, keyframes=keyframes)
    plot_error(folder / "error.png", ate, estimate.timestamps)
    return result


def evaluate_poses(estimate: NDArray[np.float64], truth: NDArray[np.float64], *, deltas: tuple[int, ...] = (1, 30)) -> Evaluation:
    """ATE and RPE of poses (N, 4, 4) against (N, 4, 4), NaN where a frame has no truth. Raises `TrajectoryError` where none has."""
    rpe = tuple(found for delta in deltas if (found := relative_pose_error(estimate, truth, delta=delta)) is not None)
    return Evaluation(len(estimate), absolute_trajectory_error(estimate, truth), rpe, None)


def load_result_trajectory(folder: Path) -> Trajectory:
    """FOLDER/trajectory.txt. Raises `ResultError` where folder or file are missing."""
    if not folder.is_dir():
        raise ResultError(f"{folder}: no such folder; expected the result of `idf-slam run`")
    if not (folder / "trajectory.txt").is_file():
        raise ResultError(f"{folder}: no trajectory.txt in it; expected the result of `idf-slam run`")
    return load_tum(folder / "trajectory.txt")


def load_mesh(path: Path) -> trimesh.Trimesh:
    """A triangle mesh [m] (PLY, OBJ, STL, OFF, GLB) with its vertex order kept. Raises `ResultError` naming the file and what is wrong."""
    if not path.is_file():
        raise ResultError(f"{path}: no such file; expected a triangle mesh (`idf-slam mesh DIR` makes one from a saved map)")
    try:
        mesh = trimesh.load_mesh(path, process=False)
    except (ValueError, KeyError, IndexError, TypeError, NotImplementedError) as error:
        raise ResultError(f"{path}: not readable as a mesh ({error}); expected a triangle mesh, e.g. PLY") from error
    if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0:
        raise ResultError(f"{path}: no triangles in it; expected a triangle mesh in metres")
    return mesh
