"""Evaluates the trajectory and the mesh in a result folder against ground truth."""

import logging
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from idfslam.errors import ResultError
from idfslam.evaluation.depth_range import DepthRange
from idfslam.evaluation.doubt import ReportedFrames, doubt_rates
from idfslam.evaluation.evaluation import Evaluation, PoseErrors
from idfslam.evaluation.files import ERROR_PICTURE, EVALUATION, FILES, TRAJECTORY_PICTURE
from idfslam.evaluation.mesh_error import SAMPLES, VIEWS, MeshError, mesh_error
from idfslam.evaluation.plots import plot_error, plot_trajectory
from idfslam.evaluation.protocols import find_protocol
from idfslam.evaluation.trajectory_error import (
    AbsoluteTrajectoryError,
    RelativePoseError,
    absolute_trajectory_error,
    first_pose_alignment,
    matched_ground_truth,
    pose_alignment,
    relative_pose_error,
)
from idfslam.evaluation.truth_plausibility import wrong_convention
from idfslam.geometry.association import TOLERANCE
from idfslam.geometry.camera import Camera
from idfslam.geometry.trajectory import Trajectory, load_tum
from idfslam.storage.ledger import Ledger

log = logging.getLogger(__name__)


def evaluate(
    folder: Path,
    *,
    gt_trajectory: Trajectory,
    gt_mesh: trimesh.Trimesh | None = None,
    camera: Camera | None = None,
    sensor_range: DepthRange | None = None,
    protocol: str = "seen",
    tolerance: float = TOLERANCE,
    keyframes: NDArray[np.int64] | None = None,
    measured: NDArray[np.bool_] | None = None,
    reported: ReportedFrames | None = None,
    samples: int = SAMPLES,
    views: int = VIEWS,
    seed: int = 0,
) -> Evaluation:
    """Errors of FOLDER/trajectory.txt and, if a true mesh is given, of FOLDER/mesh.ply; writes evaluation.json, trajectory.png, error.png.

    The alignment of all poses moves the mesh into the frame of the truth, or the first frame's true pose, by protocol; the true mesh must
    be in the frame of the true trajectory. If nothing of the mesh counts under the protocol, a warning says so and the mesh is not
    evaluated.

    camera: of the recording; with sensor_range, the depths that the sensor read, it decides which surface the recording could show.
    tolerance: largest difference of stamps [s] that belong together. keyframes: indices (K,) of the frames to mark in the plot.
    measured: (N,) whether the pose of each frame was measured; None: unknown.
    reported: all frames as they were reported at the time, by which the doubt is judged; None: unknown.
    samples: points on each surface. views: for depth L1.

    Raises `ResultError` for missing or empty files, `TrajectoryError` for trajectories that cannot be compared, `ConfigError` for an
    unknown protocol, and `ResultError` if another's file is in the place of one that is written.
    """
    rules = find_protocol(protocol)  # an unknown one fails before anything is computed
    ledger = Ledger(folder)
    ledger.refuse_foreign(FILES)
    estimate = load_result_trajectory(folder)
    truth = matched_ground_truth(estimate, gt_trajectory, tolerance=tolerance)
    result = evaluate_poses(estimate.poses, truth, measured=measured)
    ate = result.ate
    if reported is not None:
        live = Trajectory(reported.timestamps, reported.T_wc)
        result = replace(result, doubt=doubt_rates(reported, matched_ground_truth(live, gt_trajectory, tolerance=tolerance)))
    if problem := wrong_convention(estimate.poses, truth, ate):
        log.warning("%s: %s", folder, problem)
    if gt_mesh is not None:
        T_gt_est = (first_pose_alignment if rules.first_pose else pose_alignment)(estimate.poses, truth)
        measure = partial(mesh_error, poses=truth, T_gt_est=T_gt_est, sensor_range=sensor_range, samples=samples, views=views, seed=seed)
        result = replace(result, mesh=_mesh_errors(folder, gt_mesh, camera, partial(measure, protocol=protocol)))
    with ledger.replacing(EVALUATION) as part:
        result.save(part)
    with ledger.replacing(TRAJECTORY_PICTURE) as part:
        plot_trajectory(part, estimate.poses, truth, T_gt_est=ate.T_gt_est, keyframes=keyframes)
    with ledger.replacing(ERROR_PICTURE) as part:
        plot_error(part, ate, estimate.timestamps)
    return result


def _mesh_errors(folder: Path, gt_mesh: trimesh.Trimesh, camera: Camera | None, measure: Callable[..., MeshError]) -> MeshError | None:
    """The errors of FOLDER/mesh.ply, by `mesh_error` with its other arguments given; None, with a warning, if nothing of it counts."""
    if camera is None:
        raise ResultError("a true mesh is given but no camera; give size, focal lengths and principal point: they decide what was seen")
    reconstruction = load_mesh(folder / "mesh.ply")
    try:
        return measure(reconstruction, gt_mesh, camera=camera)
    except ResultError as error:  # such as a trajectory so wrong that no mesh is in view: the trajectory's error is still worth knowing
        log.warning("%s: the mesh is not evaluated: %s", folder, error)
        return None


def evaluate_poses(
    estimate: NDArray[np.float64],
    truth: NDArray[np.float64],
    *,
    deltas: tuple[int, ...] = (1, 30),
    measured: NDArray[np.bool_] | None = None,
) -> Evaluation:
    """ATE and RPE of camera-to-world poses (N, 4, 4) [m] against true ones (N, 4, 4), NaN where a frame has no truth.

    deltas: the distances in frames over which RPE is measured; one for which there is no pair of frames with truth is left out.
    measured: (N,) whether the pose of each frame was measured: the errors of these frames are told apart. None: unknown.
    Raises `TrajectoryError` if no frame has ground truth.
    """
    ate, rpe = _errors(estimate, truth, deltas)
    return Evaluation(len(estimate), ate, rpe, None, None if measured is None else _measured(estimate, truth, deltas, measured))


def _errors(
    estimate: NDArray[np.float64], truth: NDArray[np.float64], deltas: tuple[int, ...]
) -> tuple[AbsoluteTrajectoryError, tuple[RelativePoseError, ...]]:
    errors = [relative_pose_error(estimate, truth, delta=delta) for delta in deltas]
    return absolute_trajectory_error(estimate, truth), tuple(error for error in errors if error is not None)


def _measured(
    estimate: NDArray[np.float64], truth: NDArray[np.float64], deltas: tuple[int, ...], measured: NDArray[np.bool_]
) -> PoseErrors | None:
    """The errors of the frames whose pose was measured, aligned over these alone; None if none of them has ground truth."""
    known = np.where(measured[:, None, None], truth, np.nan)
    return PoseErrors(int(measured.sum()), *_errors(estimate, known, deltas)) if np.isfinite(known).all((1, 2)).any() else None


def load_result_trajectory(folder: Path) -> Trajectory:
    """Reads FOLDER/trajectory.txt. Raises `ResultError` if folder or file are missing."""
    if not folder.is_dir():
        raise ResultError(f"{folder}: no such folder; expected the result of `idf-slam run`")
    if not (folder / "trajectory.txt").is_file():
        raise ResultError(f"{folder}: no trajectory.txt in it; expected the result of `idf-slam run`")
    return load_tum(folder / "trajectory.txt")


def load_mesh(path: Path) -> trimesh.Trimesh:
    """Reads a triangle mesh [m] (PLY, OBJ, STL, OFF, GLB) and keeps the order of its vertices.

    Raises `ResultError`, which names the file and what is wrong.
    """
    if not path.is_file():
        raise ResultError(f"{path}: no such file; expected a triangle mesh (`idf-slam mesh DIR` makes one from a saved map)")
    try:
        mesh = trimesh.load_mesh(path, process=False)
    except Exception as error:  # what the parsers of mesh formats raise is not documented
        raise ResultError(f"{path}: not readable as a mesh ({error}); expected a triangle mesh, e.g. PLY") from error
    if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0:
        raise ResultError(f"{path}: no triangles in it; expected a triangle mesh in metres")
    return mesh
