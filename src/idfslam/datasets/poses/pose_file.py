"""Poses in text files of other programs: TUM, KITTI, matrices of four by four, EuRoC's csv. The form is recognised by its columns.

The numbers may be separated by spaces, tabs, commas or semicolons. A line that begins with `#` is no pose, nor is a first line that begins
with a word. Such a line may name the columns: the quaternion is qx qy qz qw unless w is named before x.
"""

import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from idfslam.errors import RecordingError
from idfslam.geometry.rigid_transform import RIGID, is_rigid
from idfslam.storage.text_file import read_text

UNIT = 0.05  # [1] difference of a quaternion's length from 1 that counts as rounded; raised, lines with swapped columns pass. Two decimals
#    are off by 0.01 at most. Chosen by hand
FORMS = "stamp tx ty tz qx qy qz qw (TUM), the 12 or 16 numbers of a matrix (KITTI), or EuRoC's csv"
_W_FIRST = re.compile(r"\bq_?(rs_)?w\b.*\bq_?(rs_)?x\b", re.IGNORECASE)  # qw qx, q_w q_x, q_RS_w [] q_RS_x []
_STAMPED = (8, 13, 17)  # columns: stamp with position and quaternion, with 3 x 4, with 4 x 4 numbers or those of EuRoC: a fact of the forms
_PLAIN = (4, 12, 16)  # columns: one row of a matrix a line, or a whole matrix: a fact of the forms


@dataclass(frozen=True, eq=False)
class PoseFile:
    """The N poses of a file, in its order."""

    path: Path
    timestamps: NDArray[np.float64] | None  # (N,) in the file's unit; None: the form has none
    T_wc: NDArray[np.float64]  # (N, 4, 4), NaN where a line holds no pose
    problems: list[str]  # one for each line that holds no pose; it names file and line


def read_pose_file(path: Path) -> PoseFile:
    """Reads a file of one of FORMS. A line that cannot be used is one of the problems.

    Raises RecordingError if the file cannot be read, or holds no line of such a form.
    """
    try:
        text = read_text(path)
    except (OSError, ValueError) as error:
        raise RecordingError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or error}); expected {FORMS}") from error
    header, lines = _lines(text)
    if not lines:
        raise RecordingError(f"{path}: no poses in it; expected lines of {FORMS}")
    columns = Counter(len(words) for _, words in lines).most_common(1)[0][0]
    if columns not in _STAMPED + _PLAIN:
        raise RecordingError(f"{path}:{lines[0][0]}: {columns} values; expected {FORMS}")
    table, problems = _table(lines, columns)
    if columns == 4:
        table, problems, lines = _joined_rows(path, table, problems, lines)
    stamps, values = (table[:, 0], table[:, 1:]) if columns in _STAMPED else (None, table)
    quaternions: NDArray[np.float64] | None = None
    if columns == 8 or (columns == 17 and not _are_matrices(values)):
        w_first = columns == 17 or bool(_W_FIRST.search(header))
        quaternions = values[:, [4, 5, 6, 3] if w_first else [3, 4, 5, 6]]
        T_wc = from_quaternions(values[:, :3], quaternions)
    else:
        T_wc = np.tile(np.eye(4), (len(values), 1, 1))
        T_wc[:, : values.shape[1] // 4] = values.reshape(len(values), -1, 4)
    finite = np.isfinite(T_wc).all((1, 2)) & np.isfinite(table[:, 0])
    rigid = finite.copy()
    rigid[finite] = is_rigid(T_wc[finite], tolerance=RIGID)
    for i in np.flatnonzero(~rigid).tolist():
        problems.setdefault(i, _problem(T_wc[i], None if quaternions is None else quaternions[i], finite=bool(finite[i])))
    T_wc[~rigid] = np.nan
    return PoseFile(path, stamps, T_wc, [f"{path}:{lines[i][0]}: {problems[i]}" for i in sorted(problems)])


def from_quaternions(positions: NDArray[np.float64], quaternions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Poses (N, 4, 4) from positions (N, 3) [m] and quaternions (N, 4) x y z w; NaN where a row is not finite.

    A quaternion whose length differs from 1 by more than UNIT gives no rotation but a matrix scaled by that length, which `is_rigid` finds.
    """
    poses = np.full((len(positions), 4, 4), np.nan)
    finite = np.isfinite(positions).all(1) & np.isfinite(quaternions).all(1)
    lengths = np.linalg.norm(quaternions[finite], axis=1)
    directions = np.where(lengths[:, None] > 0, quaternions[finite], [0.0, 0.0, 0.0, 1.0])
    scales = np.where(np.abs(lengths - 1) > UNIT, lengths, 1.0)
    poses[finite] = np.eye(4)
    poses[finite, :3, :3] = Rotation.from_quat(directions).as_matrix() * scales[:, None, None] if len(lengths) else np.zeros((0, 3, 3))
    poses[finite, :3, 3] = positions[finite]
    return poses


def _lines(text: str) -> tuple[str, list[tuple[int, list[str]]]]:
    """The header, and number and words of each line of values."""
    header = ""
    lines: list[tuple[int, list[str]]] = []
    for number, line in enumerate(text.split("\n"), 1):
        words = re.split(r"[\s,;]+", line.strip(" \t,;\r\0"))
        if not words[0]:
            continue
        if line.lstrip().startswith("#") or (not lines and not _is_number(words[0])):
            header += line
        else:
            lines.append((number, words))
    return header, lines


def _table(lines: list[tuple[int, list[str]]], columns: int) -> tuple[NDArray[np.float64], dict[int, str]]:
    """(N, columns) values, NaN in a line of another form; and what is wrong with such lines, by their index."""
    table, problems = np.full((len(lines), columns), np.nan), {}
    for i, (_, words) in enumerate(lines):
        if len(words) != columns:
            problems[i] = f"{len(words)} values; expected {columns} as in the other lines"
        elif not all(map(_is_number, words)):
            problems[i] = f"'{' '.join(words)[:60]}' holds a word that is not a number; expected {FORMS}"
        else:
            table[i] = [float(word) for word in words]
    return table, problems


def _joined_rows(
    path: Path, table: NDArray[np.float64], problems: dict[int, str], lines: list[tuple[int, list[str]]]
) -> tuple[NDArray[np.float64], dict[int, str], list[tuple[int, list[str]]]]:
    """Four lines of four values each as one line of sixteen."""
    if problems:
        raise RecordingError(f"{path}:{lines[min(problems)][0]}: {problems[min(problems)]}")
    if len(table) % 4:
        raise RecordingError(f"{path}: {len(table)} lines of 4 values; expected 4 lines for each matrix")
    return table.reshape(-1, 16), {}, lines[::4]


def _are_matrices(values: NDArray[np.float64]) -> bool:
    """Whether rows of 16 values (N, 16) are matrices: the last row is 0 0 0 1."""
    complete = values[np.isfinite(values).all(1)]
    return bool(len(complete) and (complete[:, 12:] == [0, 0, 0, 1]).all())


def _problem(T: NDArray[np.float64], quaternion: NDArray[np.float64] | None, *, finite: bool) -> str:
    """What is wrong with a pose that cannot be used."""
    if not finite:
        return "a value is not finite; remove the line if that frame has no pose"
    if quaternion is not None:
        return f"the quaternion's norm is {np.linalg.norm(quaternion):.4g}; expected 1 (order qx qy qz qw)"
    return f"not a rigid transform (det R = {np.linalg.det(T[:3, :3]):.3g}); expected a camera-to-world rotation and translation"


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
