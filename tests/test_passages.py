"""What a report says of frames in doubt, word by word."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from idfslam.frame import FrameResult, Status
from idfslam.report.passages import passages
from idfslam.runs.frame_log import FrameLog

COVARIANCE = np.diag([16e-4 / 3] * 3 + [np.deg2rad(2) ** 2 / 3] * 3)  # 4 cm and 2 degrees


def told(
    statuses: dict[int, Status], *, frames: int = 60, turn: float = 0.0, keyframes: tuple[int, ...] = (), known: bool = True
) -> list[str]:
    """A camera that turns by `turn` degrees a frame, 30 frames a second."""
    log, poses = FrameLog(), np.tile(np.eye(4), (frames, 1, 1))
    poses[:, :3, :3] = Rotation.from_rotvec(np.outer(turn * np.arange(frames), [0, 1, 0]), degrees=True).as_matrix()
    for i in range(frames):
        status = statuses.get(i, Status.OK)
        covariance = COVARIANCE * (1 if i % 2 else 0.25) if known and status.measured else None
        log.add(FrameResult(i, i / 30, poses[i], status, i in keyframes, {}, covariance), ms=1.0)
    return passages(log, poses)


def span(first: int, last: int, status: Status) -> dict[int, Status]:
    return dict.fromkeys(range(first, last + 1), status)


def test_a_sure_run_has_none() -> None:
    assert told({3: Status.DEGENERATE}) == []


@pytest.mark.parametrize(("turn", "motion"), [(1.9, ""), (4.0, " while the camera turned quickly (about 120 degrees/s)")])
def test_a_doubtful_passage(turn: float, motion: str) -> None:
    expected = (
        f"Frames 10 to 18 (0.3 s): the images did not agree with the map{motion}; "
        "the poses may be off by about 4 cm and 2 degrees; they were not mapped."
    )
    assert told(span(10, 18, Status.DOUBTFUL), turn=turn) == [expected]


def test_one_frame_and_no_covariance() -> None:
    line = "Frame 10: the images did not agree with the map; the pose may be off; it was not mapped."
    assert told(span(10, 10, Status.DOUBTFUL), known=False) == [line]


def test_lost_and_interpolated_passages() -> None:
    statuses = span(0, 4, Status.LOST) | span(20, 35, Status.INTERPOLATED) | span(40, 59, Status.LOST)
    assert told(statuses, keyframes=(45,)) == [
        "Frames 0 to 4 (0.1 s): no image gave a pose yet; the poses are those of the start; they were not mapped.",
        "Frames 20 to 35 (0.5 s): the camera was lost and found again; the poses were put between the known ones before and after; "
        "they were not mapped.",
        "Frames 40 to 59 (0.6 s): no image confirmed a pose; the last motion was carried on, so the poses may be far off.",
    ]


def test_many_passages_are_counted() -> None:
    """14 passages of one frame and one of five: the longest and the first eleven are told."""
    statuses = dict.fromkeys(range(0, 28, 2), Status.LOST) | span(40, 44, Status.LOST)
    lines = told(statuses)
    assert len(lines) == 13 and lines[11].startswith("Frames 40 to 44")
    assert lines[12] == "3 shorter passages of 3 frames in all; frames.csv has the status of each frame."
