"""Files of poses in the forms of other programs: each gives the same poses as the plain one."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from helpers.recordings import freiburg, pose, write_tum
from idfslam.datasets import open_recording
from idfslam.datasets.poses.pose_file import read_pose_file
from idfslam.errors import RecordingError

STAMPS = [100 + i / 30 for i in range(3)]
TUM = "".join(freiburg(f"{stamp:.6f}", i) + "\n" for i, stamp in enumerate(STAMPS))


def w_first(line: str) -> str:
    t, x, y, z, qx, qy, qz, qw = line.split()
    return ",".join((t, x, y, z, qw, qx, qy, qz))


def longer(line: str) -> str:
    """The line with a quaternion of length 1.03."""
    words = line.split()
    return " ".join(words[:4] + [f"{1.03 * float(word):.9f}" for word in words[4:]])


def euroc() -> str:
    """The csv of EuRoC: nanoseconds, w first, velocity and biases behind the pose."""
    header = "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [], v_RS_R_x [m s^-1] ...\n"
    rows = [w_first(line).split(",") for line in TUM.splitlines()]
    return header + "".join(",".join([f"{float(row[0]) * 1e9:.0f}", *row[1:], *["0.1"] * 9]) + "\n" for row in rows)


FORMS: dict[str, Callable[[], bytes]] = {
    "plain": TUM.encode,
    "commas": TUM.replace(" ", ",").encode,
    "commas and spaces": TUM.replace(" ", ", ").encode,
    "tabs": TUM.replace(" ", "\t").encode,
    "double spaces": TUM.replace(" ", "  ").replace("\n", "  \n").encode,
    "CRLF": TUM.replace("\n", "\r\n").encode,
    "BOM": lambda: b"\xef\xbb\xbf" + TUM.encode(),
    "UTF-16": lambda: TUM.encode("utf-16"),
    "header": lambda: b"timestamp tx ty tz qx qy qz qw\n" + TUM.encode(),
    "comment": lambda: b"# timestamp tx ty tz qx qy qz qw\n\n" + TUM.encode(),
    "w first": lambda: ("timestamp,tx,ty,tz,qw,qx,qy,qz\n" + "\n".join(map(w_first, TUM.splitlines()))).encode(),
    "unsorted and twice": lambda: ("\n".join(reversed(TUM.splitlines())) + "\n" + TUM).encode(),
    "nanoseconds": lambda: "".join(f"{1e9 * float(line.split()[0]):.0f} {line.split(' ', 1)[1]}\n" for line in TUM.splitlines()).encode(),
    "nearly unit": lambda: "".join(f"{longer(line)}\n" for line in TUM.splitlines()).encode(),
    "EuRoC": lambda: euroc().encode(),
    "stamped matrices": lambda: "".join(f"{t} {' '.join(map(str, pose(i).ravel()))}\n" for i, t in enumerate(STAMPS)).encode(),
}  # fmt: skip


@pytest.mark.parametrize("form", FORMS)
def test_every_form_of_stamped_poses(form: str, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = write_tum(tmp_path / "room")
    (path / "groundtruth.txt").write_bytes(FORMS[form]())
    truth = open_recording(path).ground_truth
    expected = np.stack([pose(i) for i in range(3)])
    np.testing.assert_allclose(truth, expected, atol=1e-6)
    assert not caplog.messages


@pytest.mark.parametrize("numbers", [12, 16, 4])
def test_poses_without_stamps(numbers: int, tmp_path: Path) -> None:
    rows = np.stack([pose(i).ravel()[: max(numbers, 12) if numbers != 4 else 16] for i in range(3)]).reshape(-1, numbers)
    np.savetxt(tmp_path / "traj.txt", rows)
    file = read_pose_file(tmp_path / "traj.txt")
    assert file.timestamps is None and not file.problems
    np.testing.assert_allclose(file.T_wc, [pose(i) for i in range(3)], atol=1e-12)


def test_each_line_that_is_no_pose_is_a_problem(tmp_path: Path) -> None:
    lines = TUM.splitlines()
    lines += ["1 2 3", "101 0 0 0 nan 0 0 1", "102 0 0 0 0 0 0 0", "103 0 0 0 0 0 one 1", "inf 0 0 0 0 0 0 1"]
    (tmp_path / "t.txt").write_text("\n".join(lines))
    file = read_pose_file(tmp_path / "t.txt")
    assert np.isfinite(file.T_wc).all((1, 2)).tolist() == [True] * 3 + [False] * 5
    expected = ["t.txt:4: 3 values", "t.txt:5: a value is not finite", "t.txt:6: the quaternion's norm is 0", "t.txt:7: '103", "t.txt:8: a"]
    assert all(text in problem for text, problem in zip(expected, file.problems, strict=True))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "no poses in it"),
        (b"# only\n", "no poses"),
        (b"1 2 3\n", "t.txt:1: 3 values; expected stamp tx"),
        (b"1 0 0 0\n", "1 lines of 4 values"),
    ],
)
def test_files_without_poses(content: bytes, message: str, tmp_path: Path) -> None:
    (tmp_path / "t.txt").write_bytes(content)
    with pytest.raises(RecordingError, match=message):
        read_pose_file(tmp_path / "t.txt")
    with pytest.raises(RecordingError, match=r"missing\.txt: cannot be read .No such file or directory."):
        read_pose_file(tmp_path / "missing.txt")
