"""Where the recordings lie that the repository does not hold."""

import os
from pathlib import Path

import pytest

FOLDER = Path(os.environ.get("IDFSLAM_DATA", Path(__file__).parents[3] / "shared"))


def shared_recording(name: str) -> Path:
    """The folder of a recording under IDFSLAM_DATA, or under ../shared beside the repository; skips the test where it is missing."""
    for folder in (FOLDER / "data" / name, FOLDER / name):
        if folder.is_dir():
            return folder
    pytest.skip(f"no recording {name} under {FOLDER}: set IDFSLAM_DATA")
