"""The check of the camera in a run: doubts are told once, in the log and in metrics.json, and a camera that fits is not doubted."""

import logging
import re
from dataclasses import replace

import numpy as np
import pytest
import torch

from idfslam.config import FAST
from idfslam.datasets.generated.room import SyntheticRoom
from idfslam.frame import Frame
from idfslam.graph.frame_poses import FramePoses
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.sensing.rectification import RowTimes
from idfslam.slam.keyframe_adjustment.camera_check import CameraCheck
from idfslam.slam.keyframe_adjustment.keyframe_motion import KeyframeMotions

LOOKS = r"the focal length looks (3\.9|4\.[012]) % too long"
EVERY = 15  # frames between two keyframes


@pytest.fixture(scope="module")
def frames() -> list[tuple[Frame, torch.Tensor]]:
    """Thirteen frames of a generated room with a Kinect's noise, and their true poses."""
    room = SyntheticRoom(seed=0, frames=600, width=320, height=240, noise=True)
    start = np.linalg.inv(room.ground_truth[0])
    return [(room[i], torch.from_numpy(start @ room.ground_truth[i])) for i in range(0, 13 * EVERY, EVERY)]


def checked(frames: list[tuple[Frame, torch.Tensor]], focal: float) -> CameraCheck:
    """The check after a run over frames whose stated focal length is `focal` times the true one."""
    graph = KeyframeGraph(replace(FAST.keyframes, cull=1.0))
    motions = KeyframeMotions(FramePoses(graph), lambda keyframe: RowTimes())
    check = CameraCheck(graph, motions, lambda keyframe: np.zeros(3))
    for frame, T_wk in frames:
        c = frame.camera
        frame = replace(frame, camera=replace(c, fx=c.fx * focal, fy=c.fy * focal))
        keyframe = Keyframe(frame, T_wk, torch.from_numpy(frame.depth), torch.from_numpy(frame.colour))
        graph.insert(keyframe)
        assert check.on_keyframe(keyframe).keyframes == ()
    assert check.figures() == {}
    check.on_finish()
    check.settle()
    return check


def test_a_wrong_focal_length_is_told_once(frames: list[tuple[Frame, torch.Tensor]], caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        found = checked(frames, 1.04).figures()
    told = [record.getMessage() for record in caplog.records if "does not fit" in record.getMessage()]
    assert len(told) == 1
    assert re.search(LOOKS, told[0])
    assert "idf-slam calibrate" in told[0]
    assert re.fullmatch(LOOKS, found["camera_doubts"][0])
    focal = found["camera_deviations"]["focal"]
    assert focal["value"] == pytest.approx(1 / 1.04 - 1, abs=0.003)
    assert 0 < focal["sigma"] < 0.002


def test_a_camera_that_fits_is_not_doubted(frames: list[tuple[Frame, torch.Tensor]], caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        found = checked(frames, 1.0).figures()
    assert found["camera_doubts"] == []
    assert not caplog.records


def test_a_run_of_few_keyframes_says_nothing(frames: list[tuple[Frame, torch.Tensor]]) -> None:
    assert checked(frames[:2], 1.04).figures() == {}
