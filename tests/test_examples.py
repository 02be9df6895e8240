"""The examples run as they stand in their heads."""

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers.box_room import BOX_FRAMES, box_poses
from idfslam.geometry.trajectory import Trajectory, save_tum

pytestmark = pytest.mark.slow

EXAMPLES = Path(__file__).parent.parent / "examples"


def example(name: str, *arguments: str, folder: Path) -> str:
    """What the example prints, run in `folder`."""
    done = subprocess.run([sys.executable, EXAMPLES / name, *arguments], cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_slam_in_ten_lines(tmp_path: Path) -> None:
    printed = example("slam_in_ten_lines.py", "3", "room.ply", folder=tmp_path)
    assert len(printed.splitlines()) == 3
    assert (tmp_path / "room.ply").stat().st_size > 10_000


def test_own_frames(tmp_path: Path) -> None:
    printed = example("own_frames.py", "8", folder=tmp_path).splitlines()
    found, expected = (float(printed[7].split(word)[1].split(" m")[0]) for word in ("x = ", "expected "))
    assert expected == 0.07
    assert abs(found - expected) < 0.02


def test_evaluate_trajectory(tmp_path: Path) -> None:
    poses = box_poses()
    save_tum(tmp_path / "truth.txt", Trajectory(np.arange(BOX_FRAMES) / 30, poses))
    moved = poses.copy()
    moved[:, :3, 3] += [1, 2, 3]  # taken out by the alignment
    save_tum(tmp_path / "estimate.txt", Trajectory(np.arange(BOX_FRAMES) / 30, moved))
    assert "ATE RMSE 0.00 cm" in example("evaluate_trajectory.py", "estimate.txt", "truth.txt", folder=tmp_path)


@pytest.mark.parametrize("name", ["first_run", "own_frames", "look_into_the_map"])
def test_notebooks_run_and_print_what_is_stored(name: str, tmp_path: Path) -> None:
    nbformat = pytest.importorskip("nbformat", reason="pip install 'idf-slam[dev]'")
    nbclient = pytest.importorskip("nbclient", reason="pip install 'idf-slam[dev]'")
    stored = nbformat.read(EXAMPLES / f"{name}.ipynb", as_version=4)
    run = nbformat.read(EXAMPLES / f"{name}.ipynb", as_version=4)
    nbclient.NotebookClient(run, timeout=300, kernel_name="python3", resources={"metadata": {"path": str(tmp_path)}}).execute()
    code = [cell for cell in stored.cells if cell.cell_type == "code"]
    assert [cell.execution_count for cell in code] == list(range(1, len(code) + 1))
    assert [shown(cell) for cell in stored.cells] == [shown(cell) for cell in run.cells]
    pictures = [output.data["image/png"] for cell in code for output in cell.outputs if "image/png" in output.get("data", {})]
    assert all(len(picture) < 400_000 for picture in pictures)  # base64: 300 kB


def shown(cell: Any) -> tuple[str, list[list[str]]]:
    """What a cell prints, with # for each number, as figures differ between machines; and the kinds of what it shows."""
    outputs = cell.get("outputs", [])
    printed = "".join(output.text for output in outputs if "text" in output)
    masked = re.sub(r" +", " ", re.sub(r"-?[0-9]+([.][0-9]*)?", "#", printed))  # arrays are padded to the width of their numbers
    return masked, [sorted(output.data) for output in outputs if "data" in output]
