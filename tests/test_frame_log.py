"""frames.csv: what comes back, and files that are none."""

import re
from pathlib import Path

import numpy as np
import pytest

from helpers.known_run import known_log
from idfslam.errors import ResultError
from idfslam.frame import FrameResult, Status
from idfslam.geometry.trajectory import Trajectory
from idfslam.runs.frame_log import FrameLog

MOVING = np.arange(8).reshape(2, 4) == 3


def test_it_comes_back(tmp_path: Path) -> None:
    known_log().save(tmp_path / "frames.csv")
    text = (tmp_path / "frames.csv").read_text().splitlines()
    fixed = "index,timestamp,status,keyframe,ms,live_status,sigma_position_cm,sigma_rotation_deg,moving_percent"
    assert text[0] == f"{fixed},total,photometric,finetune_depth"
    assert text[1] == "0,0.000000,ok,1,100.00,ok,,,0,0.5,0.125,"
    assert text[5] == "4,0.133333,lost,0,104.00,lost,,,0,,,"
    kept = FrameLog.load(tmp_path / "frames.csv")
    assert kept.lines[4].status is Status.LOST
    assert [line.index for line in kept.lines if line.keyframe] == [0, 6, 13]
    assert kept.lines[9].losses == {"finetune_depth": 0.25}
    total = kept.losses["total"]
    assert np.flatnonzero(np.isfinite(total)).tolist() == [0, 6, 13]
    assert total[0] == 0.5


def test_statuses_of_the_end_take_the_place_of_those_told() -> None:
    """The frame that a diverging map broke off has a pose, and no line."""
    log = known_log()
    statuses = [Status.INTERPOLATED if line.status is Status.LOST else line.status for line in log.lines]
    log.set_final_statuses([*statuses, Status.OK])
    assert [line.status for line in log.lines] == statuses
    assert log.lines[4].status is Status.INTERPOLATED
    assert log.lines[4].ms == 104
    assert log.lines[4].live_status is Status.LOST  # what was told at the time stays


def test_how_far_a_pose_may_be_off(tmp_path: Path) -> None:
    """Variances of 1, 4 and 4 cm^2: 3 cm; of 0.01 rad^2 each: 0.1 times the root of 3."""
    log = FrameLog()
    log.add(FrameResult(0, 0.0, np.eye(4), Status.DOUBTFUL, False, {}, np.diag([1e-4, 4e-4, 4e-4, 1e-2, 1e-2, 1e-2]), MOVING), ms=1.0)
    log.add(FrameResult(1, 0.1, np.eye(4), Status.LOST, False, {}), ms=1.0)
    assert (log.lines[0].sigma_position, log.lines[0].sigma_rotation) == pytest.approx((0.03, np.rad2deg(0.03**0.5)))
    log.set_final_statuses([Status.DOUBTFUL, Status.INTERPOLATED])
    log.save(tmp_path / "frames.csv")
    text = (tmp_path / "frames.csv").read_text().splitlines()
    assert text[1:] == ["0,0.000000,doubtful,0,1.00,doubtful,3,9.924,12.5", "1,0.100000,interpolated,0,1.00,lost,,,0"]
    kept = FrameLog.load(tmp_path / "frames.csv").lines
    assert (kept[0].sigma_position, kept[0].sigma_rotation) == pytest.approx((0.03, 9.924))
    assert (kept[0].moving, kept[1].moving) == (0.125, 0.0)
    assert (kept[1].sigma_position, kept[1].sigma_rotation, kept[1].live_status) == (None, None, Status.LOST)
    again = FrameLog()
    again.restore(log.state())
    assert again.lines == log.lines


def test_a_file_of_before_there_was_doubt(tmp_path: Path) -> None:
    (tmp_path / "frames.csv").write_text(f"{HEADER},total\n0,0.0,ok,1,3,0.5\n1,0.1,interpolated,0,3,\n")
    lines = FrameLog.load(tmp_path / "frames.csv").lines
    assert [line.live_status for line in lines] == [Status.OK, Status.INTERPOLATED] and lines[0].losses == {"total": 0.5}
    assert lines[0].sigma_position is None


def test_what_was_reported_of_each_frame() -> None:
    log, poses = known_log(), np.tile(np.eye(4), (14, 1, 1))
    log.set_final_statuses([Status.OK] * 14)
    run = log.reported(Trajectory(np.arange(14) / 30, poses), corrected={7})
    assert run.statuses[4:6] == [Status.LOST, Status.INTERPOLATED] and np.flatnonzero(run.keyframes).tolist() == [0, 6, 13]
    assert run.corrected == {7} and np.isnan(run.covariances).all()
    with pytest.raises(ResultError, match="13 poses were reported of 14 frames; expected one for each"):
        log.reported(Trajectory(np.arange(13) / 30, poses[:13]))


def test_no_frames(tmp_path: Path) -> None:
    FrameLog().save(tmp_path / "frames.csv")
    assert FrameLog.load(tmp_path / "frames.csv").lines == []


HEADER = "index,timestamp,status,keyframe,ms"


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("a,b\n1,2\n", "2: not the log of a run (no column index, timestamp, status, keyframe, ms)"),
        (f"{HEADER}\n0,0.0,fine,1,3\n", "2: not the log of a run ('fine' is not a valid Status)"),
        (f"{HEADER}\n0,0.0,ok,1,3\n0\n", "3: not the log of a run (could not convert string to float: '')"),
        (f"{HEADER}\n{10**30},0.0,ok,1,3\n", f"2: not the log of a run (frame {10**19})"),
        (f"{HEADER}\n-1,0.0,ok,1,3\n", "2: not the log of a run (frame -1)"),
        (f"{HEADER}\n0,0.0,ok,1,3,4\n", "2: not the log of a run (more values than columns)"),
    ],
)
def test_other_files_are_refused(tmp_path: Path, text: str, found: str) -> None:
    (tmp_path / "frames.csv").write_text(text)
    with pytest.raises(ResultError, match=re.escape(f"frames.csv:{found}; expected one line for each frame")):
        FrameLog.load(tmp_path / "frames.csv")
