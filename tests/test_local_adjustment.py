"""Local bundle adjustment: each new keyframe moves to where its images want it, and older ones stay."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from idfslam.config import FAST
from idfslam.datasets.generated.room import SyntheticRoom
from idfslam.frame import Frame
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.slam.compose import System
from idfslam.slam.keyframe_adjustment import global_adjustment
from idfslam.slam.keyframe_adjustment.global_adjustment import GlobalAdjustment
from idfslam.slam.keyframe_adjustment.local_adjustment import LocalAdjustment

FRAMES = range(0, 150, 15)
OFF = 0.004, 0.0015  # [m], [rad] standard deviations of a tracked pose relative to the keyframe before, in each direction


@pytest.fixture(scope="module")
def room() -> SyntheticRoom:
    """A generated room with the noise of a Kinect."""
    return SyntheticRoom(seed=0, frames=600, width=320, height=240, noise=True)


def run(room: SyntheticRoom, frames: list[Frame], *, adjusted: bool) -> tuple[KeyframeGraph, LocalAdjustment]:
    """Keyframes that are tracked from one to the next with errors, and adjusted or not."""
    system = System(FAST)
    local, rng = system.local_adjustment, np.random.default_rng(3)
    assert local is not None
    graph = system.graph
    graph.config = replace(graph.config, cull=1.0)
    true = np.asarray(room.ground_truth)[list(FRAMES)]
    for i, frame in enumerate(frames):
        error = np.eye(4)
        error[:3, 3] = OFF[0] * rng.standard_normal(3)
        error[:3, :3] = Rotation.from_rotvec(OFF[1] * rng.standard_normal(3)).as_matrix()
        T = np.eye(4) if i == 0 else graph.keyframes[-1].T_wk.numpy() @ np.linalg.inv(true[i - 1]) @ true[i] @ error
        depth, colour = torch.from_numpy(frame.depth), torch.from_numpy(frame.colour)
        keyframe = Keyframe(replace(frame, index=i), torch.from_numpy(T), depth, colour)
        graph.insert(keyframe)
        if adjusted:
            local.on_keyframe(keyframe)
    return graph, local


def error(graph: KeyframeGraph, room: SyntheticRoom) -> float:
    """[m] of the last keyframe's position."""
    true = np.asarray(room.ground_truth)
    T = np.linalg.inv(true[0]) @ true[FRAMES[-1]]
    return float(np.linalg.norm(graph.keyframes[-1].T_wk.numpy()[:3, 3] - T[:3, 3]))


@pytest.mark.slow
def test_drift_is_taken_out_while_the_camera_moves(room: SyntheticRoom) -> None:
    frames = [room[i] for i in FRAMES]
    tracked, _ = run(room, frames, adjusted=False)
    graph, local = run(room, frames, adjusted=True)
    assert error(tracked, room) > 0.01
    assert error(graph, room) < 0.004
    assert all(local.holds(keyframe) for keyframe in graph.keyframes[2:])
    assert torch.equal(graph.keyframes[0].T_wk, torch.eye(4, dtype=torch.float64))


@pytest.mark.slow
def test_images_that_do_not_agree_move_nothing(room: SyntheticRoom) -> None:
    """Each image is bent by waves of its own, of up to 2 px, as by a shutter in a shaking hand."""
    rng, frames = np.random.default_rng(1), []
    v, u = np.mgrid[:240, :320].astype(np.float32)
    for i in FRAMES[:4]:
        phase, frame = rng.uniform(0, 6, 2), room[i]
        bent = [u + 2 * np.sin(v / 25 + phase[0]).astype(np.float32), v + 2 * np.sin(v / 25 + phase[1]).astype(np.float32)]
        frames.append(replace(frame, colour=cv2.remap(frame.colour, *bent, cv2.INTER_LINEAR)))
    tracked, _ = run(room, frames, adjusted=False)
    graph, local = run(room, frames, adjusted=True)
    assert all(torch.equal(one.T_wk, other.T_wk) for one, other in zip(graph.keyframes, tracked.keyframes))
    assert not any(local.holds(keyframe) for keyframe in graph.keyframes)
    assert not local.agrees


@pytest.mark.slow
def test_the_end_of_a_long_run_uses_what_was_found_on_the_way(room: SyntheticRoom, monkeypatch: pytest.MonkeyPatch) -> None:
    """More keyframes than images fit into memory are adjusted with the landmarks that the run has found."""
    graph, local = run(room, [room[i] for i in FRAMES], adjusted=True)
    monkeypatch.setattr(global_adjustment, "_MOST_KEYFRAMES", 5)
    assert not GlobalAdjustment(graph, 60.0).run()
    adjustment = GlobalAdjustment(graph, 60.0, local.tracks)
    assert adjustment.run()
    assert adjustment.figures()["landmarks"] > 300
    assert error(graph, room) < 0.004
    assert len(adjustment.covariances()) == len(graph.keyframes)
