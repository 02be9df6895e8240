"""Trajectories: TUM files and rigid alignment (Horn 1987; Umeyama 1991)."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from idfslam.errors import IdfSlamError
from idfslam.geometry.rigid_transform import RIGID, is_rigid, rotation_error

_UNIT = 0.01  # [1] difference of a quaternion's norm from 1 in a file; raised, lines with swapped columns pass. Chosen by hand
_TUM_HEADER = "# timestamp tx ty tz qx qy qz qw\n"


class TrajectoryError(IdfSlamError):
    """A trajectory that cannot be used: damaged, not made of rigid transforms, or without a time stamp in common with another one."""


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Camera-to-world poses over time. Raises `TrajectoryError` where they are not finite or not rigid."""

    timestamps: NDArray[np.float64]  # (N,) [s]
    poses: NDArray[np.float64]  # (N, 4, 4) T_wc, translation [m]

    def __post_init__(self) -> None:
        timestamps, poses = np.asarray(self.timestamps, np.float64), np.asarray(self.poses, np.float64)
        if timestamps.ndim != 1 or poses.shape != (len(timestamps), 4, 4):
            raise TrajectoryError(f"found time stamps {timestamps.shape} and poses {poses.shape}; expected (N,) and (N, 4, 4)")
        _check_poses(timestamps, poses)
        object.__setattr__(self, "timestamps", timestamps)
        object.__setattr__(self, "poses", poses)

    def __len__(self) -> int:
        return len(self.timestamps)

    @property
    def positions(self) -> NDArray[np.float64]:
        """(N, 3) camera centres [m]."""
        return self.poses[:, :3, 3]

    @staticmethod
    def of_known(timestamps: ArrayLike, poses: ArrayLike) -> "Trajectory":
        """The trajectory of those frames, of (N,) stamps [s] and (N, 4, 4) poses, that have a pose: NaN or infinity stands for none."""
        stamps, transforms = np.asarray(timestamps, np.float64), np.asarray(poses, np.float64)
        has_pose = np.isfinite(transforms).all((1, 2))
        return Trajectory(stamps[has_pose], transforms[has_pose])


def _check_poses(timestamps: NDArray[np.float64], poses: NDArray[np.float64]) -> None:
    finite = np.isfinite(poses).all((1, 2)) & np.isfinite(timestamps)
    if not finite.all():
        i = int(np.argmin(finite))
        raise TrajectoryError(f"pose {i} (time {timestamps[i]}) is not finite; leave out frames without a pose")
    rigid = is_rigid(poses, tolerance=RIGID)
    if not rigid.all():
        i = int(np.argmin(rigid))
        R, last_row = poses[i, :3, :3], poses[i, 3].tolist()
        raise TrajectoryError(
            f"pose {i} (time {timestamps[i]}) is not a rigid transform: R^T R differs from I by {rotation_error(poses[[i]])[0]:.3g}, "
            f"det R = {np.linalg.det(R):.3g}, last row {last_row}; expected a camera-to-world rotation and translation"
        )


def save_tum(path: Path, trajectory: Trajectory, *, remark: str = "") -> None:
    """Writes one line `t tx ty tz qx qy qz qw` [s, m] a pose, with qw >= 0, after a comment with a remark if there is one."""
    quaternions = Rotation.from_matrix(trajectory.poses[:, :3, :3]).as_quat(canonical=True) if len(trajectory) else np.zeros((0, 4))
    rows = np.concatenate([trajectory.positions, quaternions], 1)
    lines = [f"{t:.6f} " + " ".join(f"{x:.9f}" for x in row) + "\n" for t, row in zip(trajectory.timestamps, rows)]
    path.write_text((f"# {remark}\n" if remark else "") + _TUM_HEADER + "".join(lines), encoding="utf-8")


def load_tum(path: Path) -> Trajectory:
    """Reads a trajectory in TUM format, as `save_tum` writes it; blank lines and `#` comments are skipped.

    Raises `TrajectoryError`, which names file and line.
    """
    if not path.is_file():
        raise TrajectoryError(f"{path}: no such file; expected a trajectory in TUM format (t tx ty tz qx qy qz qw a line)")
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except UnicodeDecodeError as error:
        raise TrajectoryError(f"{path}: not a text file; expected a trajectory in TUM format (t tx ty tz qx qy qz qw a line)") from error
    rows = [
        _tum_row(f"{path}:{number}", line) for number, line in enumerate(lines, 1) if line.strip() and not line.lstrip().startswith("#")
    ]
    if not rows:
        raise TrajectoryError(f"{path}: no poses in it; expected lines of t tx ty tz qx qy qz qw")
    values = np.array(rows)
    poses = np.tile(np.eye(4), (len(values), 1, 1))
    poses[:, :3, :3] = Rotation.from_quat(values[:, 4:]).as_matrix()
    poses[:, :3, 3] = values[:, 1:4]
    return Trajectory(values[:, 0], poses)


def _tum_row(position: str, line: str) -> list[float]:
    words = line.split()
    if len(words) != 8:
        raise TrajectoryError(f"{position}: {len(words)} values; expected 8: t tx ty tz qx qy qz qw")
    try:
        row = [float(word) for word in words]
    except ValueError as error:
        raise TrajectoryError(
            f"{position}: '{line.strip()[:60]}' holds a word that is not a number; expected t tx ty tz qx qy qz qw"
        ) from error
    if not np.isfinite(row).all():
        raise TrajectoryError(f"{position}: a value is not finite; remove the line if that frame has no pose")
    norm = float(np.linalg.norm(row[4:]))
    if abs(norm - 1) > _UNIT:
        raise TrajectoryError(f"{position}: the quaternion's norm is {norm:.4g}; expected 1 (order qx qy qz qw)")
    return row


def align(source: NDArray[np.float64], target: NDArray[np.float64]) -> NDArray[np.float64]:
    """The rigid T_target_source (4, 4), without scale, that brings points `source` (N, 3) closest to `target` (N, 3) [m] in least squares.

    Umeyama, "Least-squares estimation of transformation parameters between two point patterns", PAMI 1991, with c = 1.
    Raises `TrajectoryError` where the shapes differ or there is no point. Where the points lie on one line, the rotation
    about it is not determined and the result is one of the minimisers.
    """
    if source.shape != target.shape or source.ndim != 2 or source.shape[-1] != 3 or len(source) == 0:
        raise TrajectoryError(f"cannot align points {source.shape} with {target.shape}; expected (N, 3) both, N >= 1")
    mu_x, mu_y = source.mean(0), target.mean(0)  # Eqs. 34, 35
    covariance = (target - mu_y).T @ (source - mu_x) / len(source)  # Eq. 38
    U, _, Vt = np.linalg.svd(covariance)
    S = np.diag([1.0, 1.0, 1.0 if np.linalg.det(U) * np.linalg.det(Vt) > 0 else -1.0])  # Eqs. 39, 43: a rotation, never a reflection
    T = np.eye(4)
    T[:3, :3] = U @ S @ Vt  # Eq. 40
    T[:3, 3] = mu_y - T[:3, :3] @ mu_x  # Eq. 41
    return T


def is_rotation_determined(positions: NDArray[np.float64], *, extent: float = 0.01) -> bool:
    """Whether positions (N, 3) spread by more than `extent` [m] (standard deviation) off a line, so that `align` is unique."""
    spread = np.linalg.svd(positions - positions.mean(0), compute_uv=False) / np.sqrt(max(len(positions), 1))
    return len(spread) > 1 and bool(spread[1] > extent)
