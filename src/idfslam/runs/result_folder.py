"""The result folder of a run: the names of its files, and whose they are. Each file is written whole or not at all."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from idfslam.errors import ResultError
from idfslam.evaluation import files as evaluation_files
from idfslam.storage.ledger import Ledger
from idfslam.viewer.rerun_program import RECORDING as RECORDING

TRAJECTORY, LIVE, MESH, MAP = "trajectory.txt", "live_trajectory.txt", "mesh.ply", "map.safetensors"
KEYFRAMES, CONFIG, METRICS, PICTURE = "keyframes.json", "config.yaml", "metrics.json", evaluation_files.TRAJECTORY_PICTURE
ARCHIVE, FRAMES, REPORT, SCENE, PICTURES = "archive.safetensors", "frames.csv", "report.html", "scene.html", "pictures"
CHECKPOINT = "checkpoint.safetensors"  # of an unfinished run
FILES = (
    TRAJECTORY,
    LIVE,
    MESH,
    MAP,
    ARCHIVE,
    KEYFRAMES,
    CONFIG,
    METRICS,
    FRAMES,
    PICTURE,
)  # of a run
EVALUATION, EVALUATION_FILES = evaluation_files.EVALUATION, evaluation_files.FILES
_PICTURE = re.compile(r"(trajectory|error|frames|stages|losses|mesh|inside|view|slice|moving)(_[0-9a-z_]+)?\.png")  # a picture of a report
SCHEMA = 1  # of keyframes.json and metrics.json; counts up when a reader of the older form would misread a file


@contextmanager
def writing(folder: Path) -> Iterator[None]:
    """Turns an OSError of the `with` block, such as a full disk or a removed folder, into a ResultError."""
    try:
        yield
    except OSError as error:
        advice = f"make room or give permission, then continue from the last checkpoint with `idf-slam run --resume {folder}`"
        raise ResultError(f"{error.filename or folder}: cannot be written ({error.strerror or error}); {advice}") from error


def ledger(folder: Path) -> Ledger:
    """The ledger of a result folder. In one without (a copy without hidden files, an older version) the files of a run count as its own."""
    found = Ledger(folder)
    if not found.marks and all((folder / name).is_file() for name in (TRAJECTORY, KEYFRAMES, CONFIG)):
        found.record([name for name in FILES if (folder / name).is_file()])
    return found


def report_files(folder: Path) -> set[str]:
    """The names of report.html, of scene.html and of the files in pictures/ that are named as a report's pictures."""
    pictures = {f"{PICTURES}/{path.name}" for path in (folder / PICTURES).glob("*.png") if _PICTURE.fullmatch(path.name)}
    return {REPORT, SCENE, *pictures}


def existing(folder: Path, name: str) -> Path:
    """The path of a result file. Raises ResultError if it does not exist."""
    path = folder / name
    if not folder.is_dir():
        raise ResultError(f"{folder}: no such folder; expected the results of `idf-slam run`")
    if not path.is_file():
        found = ", ".join(f for f in FILES if (folder / f).is_file()) or "no result file at all"
        raise ResultError(f"{folder}: has no {name} (found {found}); expected the results of a finished `idf-slam run`")
    return path
