"""frames.csv: what comes back, and files that are none."""

import re
from pathlib import Path

import numpy as np
import pytest

from helpers.known_run import known_log
from idfslam.errors import ResultError
from idfslam.frame import Status
from idfslam.runs.frame_log import FrameLog


def test_it_comes_back(tmp_path: Path) -> None:
    known_log().save(tmp_path / "frames.csv")
    text = (tmp_path / "frames.csv").read_text().splitlines()
    assert text[0] == "index,timestamp,status,keyframe,ms,total,photometric,finetune_depth"
    assert text[1] == "0,0.000000,ok,1,100.00,0.5,0.125,"
    assert text[5] == "4,0.133333,lost,0,104.00,,,"
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
