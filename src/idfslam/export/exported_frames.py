"""The frames of a run that are exported as images: its keyframes, or frames spread over it."""

import itertools
import logging
from collections.abc import Iterator

from idfslam.errors import FrameError, RecordingError
from idfslam.export.images import PosedImage
from idfslam.runs.finished_run import FinishedRun
from idfslam.runs.prior_map import earlier_keyframes

log = logging.getLogger(__name__)


def posed_images(run: FinishedRun, count: int | None, *, guessed: bool = False) -> Iterator[PosedImage]:
    """`count` frames spread over the run; None: the keyframes, first those of the map that it started in. Poses are in the run's world.

    guessed: with those whose pose was not measured or is in doubt. An unreadable frame is reported and left out.
    Raises RecordingError if none is left.
    """
    found = False
    for image in itertools.chain(_earlier(run) if count is None else (), _own(run, count, guessed)):
        found = True
        yield image
    if not found:
        raise RecordingError(f"{run.folder}: none of the frames to export can be read")


def _earlier(run: FinishedRun) -> Iterator[PosedImage]:
    """The keyframes of the map that the run started in."""
    for i, keyframe in enumerate(earlier_keyframes(run.keyframes.earlier)):
        yield PosedImage(f"earlier_{i:06d}.png", keyframe.T_wk.numpy(), keyframe.frame)


def _own(run: FinishedRun, count: int | None, guessed: bool) -> Iterator[PosedImage]:
    """Frames of the run's own recording."""
    if count is None and run.keyframes.earlier and not len(run.keyframes.indices):
        return  # the map that the run started in needed no keyframe of it
    for i in map(int, run.frames_to_show(count, guessed=guessed)):
        try:
            yield PosedImage(f"{i:06d}.png", run.trajectory.poses[i], run.recording[i], run.statuses[i])
        except FrameError as error:
            log.warning("%s; the frame is left out", error)
