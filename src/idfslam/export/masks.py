"""Masks of what moves, one PNG for each image of the archive: white what stays, black what moves, as nerfstudio and COLMAP have them."""

from pathlib import Path

import numpy as np
from PIL import Image

from idfslam.errors import ResultError
from idfslam.graph.coverage import EARLIER
from idfslam.runs.finished_run import FinishedRun
from idfslam.storage import atomic_files


def write_masks(folder: Path, run: FinishedRun) -> Path:
    """Writes NNNNNN.png for each frame of the run that its archive keeps, of the size of the recording. Returns the folder.

    Raises ResultError for a run without an archive.
    """
    archive = run.archive
    if archive is None:
        raise ResultError(f"{run.folder}: keeps no images, which tell what moves; run again without --no-archive")
    atomic_files.prepare(folder)
    for i, view in enumerate(archive.views):
        if view.index != EARLIER:
            with atomic_files.replacing(folder / f"{view.index:06d}.png") as part:
                Image.fromarray(np.where(archive.moving(i), 0, 255).astype(np.uint8)).save(part, "PNG")
    return folder
