"""Ground truth: the true poses of a recording's frames, camera-to-world in metres; a matrix of NaN stands for a missing pose.

It is only evaluated against, so that nothing that is wrong with it stops a run: `optional_truth` turns every fault into a warning.
"""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from idfslam.datasets.poses.pose_file import read_pose_file
from idfslam.datasets.time_stamps import in_seconds_near
from idfslam.errors import IdfSlamError, RecordingError
from idfslam.geometry.association import TOLERANCE
from idfslam.geometry.rigid_transform import RIGID, is_rigid
from idfslam.storage.text_file import read_text

log = logging.getLogger(__name__)

_LONGEST_STEP = 2.0  # [m] from pose to pose, in the median; raised, slow cameras in millimetres pass (20 mm a frame is 20). Chosen by hand


@dataclass(frozen=True, eq=False)
class Truth:
    """The poses of N frames as they were read."""

    T_wc: NDArray[np.float64]  # (N, 4, 4), NaN: none
    source: str  # the file or topic
    problems: Sequence[str] = ()  # what is wrong with single poses, of which the frames have none


ReadTruth = Callable[[], Truth | None]  # None: the recording has no ground truth


def optional_truth(read: ReadTruth | None, *, count: int) -> NDArray[np.float64] | None:
    """(N, 4, 4) the true poses of `count` frames, NaN where a frame has none; None where the recording has none that can be used.

    Raises nothing: one warning says what is wrong, and which frames are concerned.
    """
    try:
        truth = None if read is None else read()
        return None if truth is None else _usable(truth, count)
    except (IdfSlamError, OSError, ValueError) as error:
        log.warning("%s: the run has no ground truth", error)
        return None


def _usable(truth: Truth, count: int) -> NDArray[np.float64]:
    """The poses, all NaN where one is not finite or not rigid. Raises RecordingError if the count is wrong or no pose is left."""
    if len(truth.T_wc) != count:
        raise RecordingError(f"{truth.source}: {len(truth.T_wc)} poses for {count} frames, expected one for each")
    T_wc, problems = truth.T_wc.copy(), list(truth.problems)
    usable = np.isfinite(T_wc).all((1, 2))
    rigid = is_rigid(T_wc[usable], tolerance=RIGID)
    problems += [f"{truth.source}: the pose of frame {i} is not a rigid transform" for i in np.flatnonzero(usable)[~rigid]]
    usable[usable] = rigid
    T_wc[~usable] = np.nan
    if not usable.any():
        raise RecordingError(problems[0] if problems else f"{truth.source}: none of the {count} poses is finite")
    warn_if_in_millimetres(T_wc, truth.source)
    if problems:
        more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
        log.warning("%s%s: %d of %d frames have ground truth", problems[0], more, usable.sum(), count)
    return T_wc


def warn_if_in_millimetres(T_wc: NDArray[np.float64], source: str) -> None:
    """A warning if a camera at poses (N, 4, 4), NaN where one is missing, would be faster than any that films a room."""
    steps = np.linalg.norm(np.diff(T_wc[:, :3, 3], axis=0), axis=1)
    steps = steps[np.isfinite(steps)]
    if len(steps) and (step := float(np.median(steps))) > _LONGEST_STEP:
        log.warning("%s: the camera moves %.3g m from pose to pose, expected metres: are its positions in millimetres?", source, step)


def read_matrix(path: Path) -> NDArray[np.float64]:
    """Reads one pose (4, 4) from a file of 16 numbers; inf and nan are allowed and mean no pose. Raises RecordingError."""
    words = read_text(path).replace(",", " ").split()
    try:
        numbers = [float(word) for word in words]
    except ValueError as error:
        raise RecordingError(f"{path}: {error}, expected numbers of a camera-to-world pose") from error
    if len(numbers) != 16:
        raise RecordingError(f"{path}: {len(numbers)} numbers, expected a 4x4 camera-to-world matrix")
    return np.array(numbers).reshape(4, 4)


def read_stamped(path: Path, wanted: NDArray[np.float64]) -> Truth:
    """For each of the stamps `wanted` (N,) [s] the pose of a file of stamped poses that is nearest in time, NaN if none is within 20 ms.

    The file's stamps may be in seconds, milliseconds, microseconds or nanoseconds. Raises RecordingError if no pose is near a stamp.
    """
    file = read_pose_file(path)
    if file.timestamps is None:
        raise RecordingError(f"{path}: poses without stamps, expected lines of stamp tx ty tz qx qy qz qw")
    known = np.isfinite(file.T_wc).all((1, 2))
    if not known.any():
        raise RecordingError(file.problems[0])
    stamps, T_wc = in_seconds_near(file.timestamps[known], wanted), file.T_wc[known]
    order = np.argsort(stamps, kind="stable")
    selected = at_stamps(stamps[order], T_wc[order], wanted, TOLERANCE)
    if not np.isfinite(selected).all((1, 2)).any():
        span = f"poses from {stamps.min():.3f} to {stamps.max():.3f} s, images from {wanted.min():.3f} to {wanted.max():.3f} s"
        raise RecordingError(f"{path}: {span}: no pose within {1000 * TOLERANCE:.0f} ms of an image, expected stamps of one clock")
    return Truth(selected, str(path), file.problems)


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
