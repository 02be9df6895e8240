"""Ground-truth poses from text files: camera-to-world, in metres; a matrix of NaN stands for a missing pose."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from idfslam.errors import RecordingError
from idfslam.geometry.rigid_transform import is_rigid

RIGID = 1e-2  # [1] largest entry of |R^T R - I| of a pose; raised, damaged rotations pass. Ten times that of our own files: published
#    recordings round their numbers to three decimals
_UNIT = 1e-2  # [1] difference of a quaternion's length from 1, likewise


def read_matrix(path: Path) -> NDArray[np.float64]:
    """Reads one pose (4, 4) from a file of 16 numbers; inf and nan are allowed and mean no pose."""
    rows = _rows(path)
    numbers = [number for row in rows for number in row]
    if len(numbers) != 16:
        raise RecordingError(f"{path}: {len(numbers)} numbers, expected a 4x4 camera-to-world matrix")
    return np.array(numbers).reshape(4, 4)


def read_matrices(path: Path) -> NDArray[np.float64]:
    """Reads poses (N, 4, 4) from lines of 16 numbers."""
    rows = _rows(path)
    for line, row in enumerate(rows, 1):
        if len(row) != 16:
            raise RecordingError(f"{path}: pose {line} has {len(row)} numbers, expected the 16 of a 4x4 camera-to-world matrix")
    return np.array(rows).reshape(-1, 4, 4)


def read_freiburg(path: Path) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Reads stamps (N,) [s] and poses (N, 4, 4) from lines `stamp tx ty tz qx qy qz qw` (TUM), sorted by stamp."""
    rows = _rows(path)
    for line, row in enumerate(rows, 1):
        if len(row) != 8:
            raise RecordingError(f"{path}: pose {line} has {len(row)} numbers, expected stamp tx ty tz qx qy qz qw")
    table = np.array(rows).reshape(-1, 8)
    table = table[np.argsort(table[:, 0], kind="stable")]
    try:
        return table[:, 0], from_quaternions(table[:, 1:4], table[:, 4:])
    except ValueError as error:
        raise RecordingError(f"{path}: {error} in stamp tx ty tz qx qy qz qw") from error


def from_quaternions(positions: NDArray[np.float64], quaternions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Poses (N, 4, 4) from positions (N, 3) [m] and quaternions (N, 4) x y z w; NaN where a row is not finite.

    Raises ValueError if a quaternion is not of length 1.
    """
    poses = np.full((len(positions), 4, 4), np.nan)
    finite = np.isfinite(positions).all(1) & np.isfinite(quaternions).all(1)
    lengths = np.linalg.norm(quaternions[finite], axis=1)
    if np.any(np.abs(lengths - 1) > _UNIT):
        raise ValueError(f"a quaternion has length {lengths[np.abs(lengths - 1).argmax()]:.3g}, expected 1")
    poses[finite] = np.eye(4)
    poses[finite, :3, :3] = Rotation.from_quat(quaternions[finite]).as_matrix()
    poses[finite, :3, 3] = positions[finite]
    return poses


def at_stamps(
    stamps: NDArray[np.float64], poses: NDArray[np.float64], wanted: NDArray[np.float64], tolerance: float
) -> NDArray[np.float64]:
    """(N, 4, 4) the pose nearest in time to each of the `wanted` stamps (N,) [s], NaN if none lies within `tolerance` [s].

    stamps: (M,) [s], sorted, of the poses (M, 4, 4).
    """
    right = np.searchsorted(stamps, wanted).clip(1, max(len(stamps) - 1, 1))
    left = right - 1
    right = np.minimum(right, len(stamps) - 1)
    nearest = np.where(np.abs(stamps[left] - wanted) <= np.abs(stamps[right] - wanted), left, right)
    selected: NDArray[np.float64] = poses[nearest].copy()
    selected[np.abs(stamps[nearest] - wanted) > tolerance] = np.nan
    return selected


def checked(poses: NDArray[np.float64], *, count: int, source: Callable[[int], str]) -> NDArray[np.float64]:
    """Validated poses (N, 4, 4); a matrix with any entry that is not finite becomes all NaN. `source(i)` names pose i in messages.

    Raises RecordingError if there are not `count` poses, if a pose is not rigid, or if no pose is finite.
    """
    if len(poses) != count:
        raise RecordingError(f"{source(0)}: {len(poses)} poses for {count} frames, expected one for each: complete or remove them")
    poses = poses.copy()
    finite = np.isfinite(poses).all((1, 2))
    poses[~finite] = np.nan
    if not finite.any():
        raise RecordingError(f"{source(0)}: none of the {count} poses is finite: remove them to run without ground truth")
    rigid = is_rigid(poses[finite], tolerance=RIGID)
    if not rigid.all():
        first = int(np.flatnonzero(finite)[rigid.argmin()])
        raise RecordingError(
            f"{source(first)}: pose {first} is not a rigid transform, expected camera-to-world: correct or remove the poses"
        )
    return poses


def _rows(path: Path) -> list[list[float]]:
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    try:
        return [[float(number) for number in line.split()] for line in lines if line.strip() and not line.lstrip().startswith("#")]
    except ValueError as error:
        raise RecordingError(f"{path}: {error}, expected numbers of camera-to-world poses") from error
