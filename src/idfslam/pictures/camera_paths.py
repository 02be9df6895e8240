"""Paths of a virtual camera: poses from a file, a smooth flight along a trajectory, an orbit in a room."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline
from scipy.spatial.transform import Rotation, RotationSpline

from idfslam.datasets.poses.pose_file import read_pose_file
from idfslam.errors import RecordingError, ResultError
from idfslam.geometry.camera import Camera
from idfslam.geometry.transforms_json import read_transforms
from idfslam.pictures.mesh_renderer import looking_at
from idfslam.storage.text_file import read_text

Floats = NDArray[np.float64]
_KNOTS_PER_SECOND = 1.5  # of the splines; more: the flight follows the trajectory, and its shake, more closely


def load_poses(path: Path) -> tuple[Floats, Camera | None]:
    """T_wc (N, 4, 4) of a file of poses (`read_pose_file`) or a transforms.json, told by its content; and the camera if the file has one.

    Raises ResultError for a missing file, another format, or a line that is no pose.
    """
    try:
        text = read_text(path)
    except OSError as error:
        raise ResultError(f"{path}: cannot be read as text; expected poses in TUM or KITTI format, or transforms.json") from error
    if path.suffix == ".json" or text.lstrip().startswith("{"):
        return read_transforms(path)
    try:
        file = read_pose_file(path)
    except RecordingError as error:
        raise ResultError(f"{error}, or transforms.json") from error
    if file.problems:
        raise ResultError(file.problems[0])
    return file.T_wc, None


def fly_through(poses: Floats, frames: int, *, fps: float) -> Floats:
    """(M, 4, 4) evenly timed poses of a smooth flight along T_wc (N, 4, 4): splines through means of the poses, which removes the shake."""
    if len(poses) < 2:
        return np.repeat(poses, frames, 0)
    knots = int(np.clip(round(frames / fps * _KNOTS_PER_SECOND), 2, len(poses)))
    times, knot_times = np.linspace(0, 1, frames), np.linspace(0, 1, knots)
    reach = len(poses) // (2 * knots)
    near = [_around(poses, round(float(i)), reach) for i in knot_times * (len(poses) - 1)]
    out = np.tile(np.eye(4), (frames, 1, 1))
    rotations = Rotation.concatenate([Rotation.from_matrix(few[:, :3, :3]).mean() for few in near])
    out[:, :3, :3] = RotationSpline(knot_times, rotations)(times).as_matrix()
    out[:, :3, 3] = make_interp_spline(knot_times, [few[:, :3, 3].mean(0) for few in near], k=min(3, knots - 1))(times)
    return out


def _around(poses: Floats, i: int, reach: int) -> Floats:
    """Pose i with up to `reach` poses on either side, equally many."""
    reach = min(reach, i, len(poses) - 1 - i)
    return poses[i - reach : i + reach + 1]


def orbit(poses: Floats, frames: int, *, up: Floats, centre: Floats, radius: float) -> Floats:
    """(M, 4, 4) poses on a circle around `centre` (3,), looking outwards: a room is seen from within.

    The circle has `radius` [m], lies perpendicular to `up`, and has the mean height of the poses T_wc (N, 4, 4).
    """
    up = up / np.linalg.norm(up)
    side = np.cross(up, poses[0, :3, 2])
    side = np.cross(up, np.eye(3)[np.argmin(np.abs(up))]) if np.linalg.norm(side) < 0.1 else side
    side /= np.linalg.norm(side)
    ahead = np.cross(side, up)
    height = float(((poses[:, :3, 3] - centre) @ up).mean())
    out = []
    for angle in 2 * np.pi * np.arange(frames) / frames:
        direction = np.cos(angle) * ahead + np.sin(angle) * side
        eye = centre + up * height + radius * direction
        out.append(looking_at(eye + direction, eye, up))
    return np.stack(out)
