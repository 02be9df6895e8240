"""Milliseconds by stage."""

import time

from idfslam.slam.stage_timer import StageTimer


def test_each_call_is_timed() -> None:
    timer = StageTimer()
    for _ in range(2):
        with timer.stage("map"):
            time.sleep(0.01)
    with timer.stage("align"), timer.stage("inner"):
        pass
    assert {stage: len(times) for stage, times in timer.milliseconds.items()} == {"map": 2, "inner": 1, "align": 1}
    assert all(ms >= 10 for ms in timer.milliseconds["map"])
    assert timer.milliseconds["align"][0] >= timer.milliseconds["inner"][0]


def test_state() -> None:
    timer, again = StageTimer(), StageTimer()
    timer.milliseconds["map"] += [1.5, 2.25]
    again.restore(timer.state())
    assert again.milliseconds == {"map": [1.5, 2.25]}
    again.milliseconds["new"].append(1.0)  # a stage that was not run before
    assert timer.milliseconds == {"map": [1.5, 2.25]}
