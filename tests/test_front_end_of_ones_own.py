"""The worked example of docs/design.md: a front end in a file outside the package takes the place of the fast preset's."""

import re
import runpy
from pathlib import Path

import numpy as np
import pytest

from idfslam.config import FAST
from idfslam.datasets import Selection
from idfslam.datasets.generated.room import SyntheticRoom
from idfslam.evaluation.evaluate import evaluate_poses
from idfslam.frame import Status
from idfslam.slam import Slam

ROOT = Path(__file__).parent.parent
EXAMPLE = ROOT / "examples" / "orb_front_end.py"


def test_the_documentation_shows_the_example_as_it_is() -> None:
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "design.md").read_text(encoding="utf-8"), re.DOTALL)
    program = EXAMPLE.read_text(encoding="utf-8")
    assert program in blocks
    assert len(program.splitlines()) == 40


@pytest.mark.slow
def test_the_example_tracks_a_room_and_a_lost_camera_is_found_again() -> None:
    room = Selection(SyntheticRoom(seed=0, frames=240, width=320, height=240), frames=20, stride=4)
    assert room.ground_truth is not None
    slam = Slam(FAST, front_end=runpy.run_path(str(EXAMPLE))["OrbFrontEnd"])
    frames = [room[i] for i in range(20)]
    frames[14].depth[:] = 0  # nothing to register against, and no pose
    frames[14].colour[:] = 0
    statuses = [slam.process(frame).status for frame in frames]
    assert [i for i, status in enumerate(statuses) if status is Status.LOST] == [14]
    assert slam.statuses()[14] is Status.INTERPOLATED
    slam.finish()
    error = evaluate_poses(slam.trajectory(), room.ground_truth[:20]).ate
    assert error is not None
    assert error.translation.rmse < 0.01
    assert len(slam.graph.keyframes) >= 2
    assert np.isfinite(slam.mesh(0.05).vertices).all()
