"""The progress of a run as lines of text, and what a first run says before it compiles."""

import io
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from idfslam.config import FAST, PAPER
from idfslam.frame import FrameResult, Status
from idfslam.runs import progress
from idfslam.runs.metrics import read_metrics
from idfslam.runs.progress import ProgressBar
from idfslam.runs.run_config import RecordingSource
from idfslam.runs.runner import run
from idfslam.runs.source import open_source
from idfslam.slam import warm_up


class Clock:
    """A clock that the test moves."""

    now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(progress, "monotonic", clock)
    return clock


def result(index: int, status: Status = Status.OK) -> FrameResult:
    return FrameResult(index, index / 30, np.eye(4), status, keyframe=False, losses={})


def test_lines_come_with_the_first_frame_and_every_ten_seconds(clock: Clock) -> None:
    text = io.StringIO()
    with ProgressBar(900, Console(file=text)) as bar:
        for i in range(250):
            clock.now += 0.125
            bar.update(result(i, Status.LOST if i == 7 else Status.OK), frames_per_second=10.0, keyframes=1 + i // 50)
        bar.describe("refining")
    assert text.getvalue().splitlines() == [
        "frames 1 of 900, 10.00 frames/s, keyframes 1",
        "frames 81 of 900, 10.00 frames/s, 1:22 left, keyframes 2, lost 1",
        "frames 161 of 900, 10.00 frames/s, 1:14 left, keyframes 4, lost 1",
        "frames 241 of 900, 10.00 frames/s, 1:06 left, keyframes 5, lost 1",
        "refining",
    ]


def test_a_stream_of_unknown_length_has_no_time_left(clock: Clock) -> None:
    text = io.StringIO()
    with ProgressBar(None, Console(file=text)) as bar:
        bar.update(result(0), frames_per_second=10.0, keyframes=1)
    assert text.getvalue() == "frames 1, 10.00 frames/s, keyframes 1\n"


def test_a_quiet_console_shows_nothing(clock: Clock) -> None:
    text = io.StringIO()
    with ProgressBar(9, Console(file=text, quiet=True)) as bar:
        bar.update(result(0), frames_per_second=10.0, keyframes=1)
        bar.describe("refining")
    assert not text.getvalue()


def test_keyframes_of_progress_and_summary_agree(box_recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "_BETWEEN_LINES", 0.0)
    text = io.StringIO()
    source = RecordingSource(str(box_recording))
    config = replace(FAST, device="cpu", keyframes=replace(FAST.keyframes, translation=0.01, cull=0.5))
    done = run(open_source(source), config, tmp_path / "out", source=source, console=Console(file=text))
    told = [int(count) for count in re.findall(r"keyframes (\d+)", text.getvalue())]
    assert told[-1] == done.metrics["keyframes"] == read_metrics(tmp_path / "out")["keyframes"]
    assert "refining" in text.getvalue()


def test_a_first_run_says_that_it_compiles(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(warm_up, "kernels_on_disk", lambda: False)
    assert warm_up.will_compile(replace(FAST, device="cpu"))
    assert not warm_up.will_compile(replace(PAPER, device="cpu"))
    monkeypatch.setattr(warm_up, "kernels_on_disk", lambda: True)
    assert not warm_up.will_compile(replace(FAST, device="cpu"))
