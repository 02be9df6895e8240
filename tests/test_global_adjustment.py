"""Global bundle adjustment: it moves keyframes to where the images want them, if the images agree, and says how sure it is."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from idfslam.adjustment.observations import Observations
from idfslam.config import FAST
from idfslam.datasets.generated.faults import Faults
from idfslam.datasets.generated.handheld import handheld_room
from idfslam.datasets.generated.room import SyntheticRoom
from idfslam.frame import Frame, Status
from idfslam.geometry import se3
from idfslam.graph.frame_poses import FramePoses
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.sensing.rectification import RowTimes
from idfslam.slam.keyframe_adjustment.global_adjustment import GlobalAdjustment, NoAdjustment, reprojections_agree
from idfslam.slam.keyframe_adjustment.keyframe_motion import KeyframeMotions

FRAMES = range(0, 160, 20)
OFF = 0.003, 0.001  # [m], [rad] standard deviations of the poses before, in each direction


@pytest.fixture(scope="module")
def room() -> SyntheticRoom:
    """A generated room with the noise of a Kinect."""
    return SyntheticRoom(seed=0, frames=600, width=320, height=240, noise=True)


def truth(room: SyntheticRoom) -> np.ndarray:
    """(K, 4, 4) true poses of the keyframes, in the frame of the first."""
    poses = np.asarray(room.ground_truth)[list(FRAMES)]
    return np.linalg.inv(poses[0]) @ poses


def graph_of(frames: list[Frame], true: np.ndarray) -> KeyframeGraph:
    """Keyframes at poses that are off, all but the first."""
    rng, graph = np.random.default_rng(3), KeyframeGraph(replace(FAST.keyframes, cull=1.0))
    for i, (frame, T) in enumerate(zip(frames, true)):
        error = np.eye(4)
        if i:
            error[:3, 3] = OFF[0] * rng.standard_normal(3)
            error[:3, :3] = Rotation.from_rotvec(OFF[1] * rng.standard_normal(3)).as_matrix()
        depth, colour = torch.from_numpy(frame.depth), torch.from_numpy(frame.colour)
        graph.insert(Keyframe(replace(frame, index=i), torch.from_numpy(T @ error), depth, colour))
    return graph


def errors(graph: KeyframeGraph, true: np.ndarray) -> np.ndarray:
    """(K,) [m] the distances to the true positions."""
    return np.array([np.linalg.norm(k.T_wk.numpy()[:3, 3] - T[:3, 3]) for k, T in zip(graph.keyframes, true)])


@pytest.mark.parametrize(
    ("width", "off", "agree"),
    [(640, 0.34, True), (640, 0.36, False), (320, 0.24, True), (320, 0.25, False), (160, 0.21, True), (160, 0.22, False)],
)
def test_reprojections_agree_within_what_places_are_found_to(width: int, off: float, agree: bool) -> None:
    """off [px] of an image of this width. At 320: sqrt(0.29^2 + (2 * 0.2)^2) = 0.494 px of 640, which are 0.247 there; at 160 0.213."""
    none, flat, one = np.zeros(0, np.int64), np.zeros((1, 2)), np.zeros(1)
    seen = Observations(none, np.zeros(1, np.int64), flat, np.eye(2)[None] / off, one, one, flat)
    assert reprojections_agree(seen, width) == agree


def test_the_keyframes_move_to_where_the_images_want_them(room: SyntheticRoom) -> None:
    true = truth(room)
    graph = graph_of([room[i] for i in FRAMES], true)
    assert errors(graph, true)[1:].mean() > 0.004
    adjustment = GlobalAdjustment(graph, 60.0)
    assert adjustment.figures() == {"keyframes_adjusted": False}
    assert adjustment.run()
    assert errors(graph, true).max() < 0.002  # 0.3 to 1.1 mm here
    assert errors(graph, true)[0] == 0
    assert adjustment.figures()["keyframes_adjusted"]
    assert adjustment.figures()["landmarks"] > 300


def test_the_covariances_tell_the_errors(room: SyntheticRoom) -> None:
    true = truth(room)
    graph = graph_of([room[i] for i in FRAMES], true)
    adjustment = GlobalAdjustment(graph, 60.0)
    adjustment.run()
    covariances, squares = adjustment.covariances(), []
    assert not covariances[0].any()  # the first keyframe is the world
    for i, keyframe in list(enumerate(graph.keyframes))[1:]:
        off = se3.log(se3.inverse(keyframe.T_wk) @ torch.from_numpy(true[i])).numpy()
        squares.append(off @ np.linalg.solve(covariances[i], off) / 6)
    assert 0.3 < np.mean(squares) < 2.0  # 0.85 here


def test_images_that_do_not_agree_move_nothing(room: SyntheticRoom) -> None:
    """Each image is bent by waves of its own, of up to 2 px, as by a shutter in a shaking hand."""
    rng, frames = np.random.default_rng(1), []
    v, u = np.mgrid[:240, :320].astype(np.float32)
    for i in FRAMES:
        phase, frame = rng.uniform(0, 6, 2), room[i]
        bent = [u + 2 * np.sin(v / 25 + phase[0]).astype(np.float32), v + 2 * np.sin(v / 25 + phase[1]).astype(np.float32)]
        frames.append(replace(frame, colour=cv2.remap(frame.colour, *bent, cv2.INTER_LINEAR)))
    graph = graph_of(frames, truth(room))
    before = [keyframe.T_wk.clone() for keyframe in graph.keyframes]
    adjustment = GlobalAdjustment(graph, 60.0)
    assert not adjustment.run()
    assert all(torch.equal(keyframe.T_wk, T) for keyframe, T in zip(graph.keyframes, before))
    assert adjustment.covariances() == {}


def test_where_time_has_run_out_nothing_moves(room: SyntheticRoom) -> None:
    graph = graph_of([room[i] for i in FRAMES], truth(room))
    assert not GlobalAdjustment(graph, 1e-9).run()


def test_two_keyframes_stay(room: SyntheticRoom) -> None:
    graph = graph_of([room[i] for i in FRAMES[:2]], truth(room))
    assert not GlobalAdjustment(graph, 60.0).run()
    assert not NoAdjustment().run()


@pytest.mark.slow
def test_a_rolling_shutter_bends_nothing_where_keyframes_have_velocities() -> None:
    """Raw images of a shaken camera with a rolling shutter, at true poses: the adjustment leaves them there if it knows the rows' times."""
    room = handheld_room(Faults.named("shutter"), seed=1, frames=140, width=320, height=240)
    true, times = np.linalg.inv(room.ground_truth[50]) @ room.ground_truth, room.true_timing
    off = []
    for knows in (False, True):
        frames = FramePoses(KeyframeGraph(replace(FAST.keyframes, cull=1.0)))
        for i in range(50, 140):
            frames.append(float(room.timestamps[i]), torch.from_numpy(true[i]), Status.OK)
            if i % 10 == 0:
                frame = replace(room[i], index=i)
                frames.graph.insert(
                    keyframe := Keyframe(frame, torch.from_numpy(true[i]), torch.from_numpy(frame.depth), torch.from_numpy(frame.colour))
                )
                frames.attach_last(keyframe)
        motions = KeyframeMotions(frames, lambda keyframe: RowTimes(times.readout or 0.0, times.depth_readout or 0.0))
        assert GlobalAdjustment(frames.graph, 60.0, None, motions if knows else None).run() == knows
        if knows:
            off = [np.linalg.norm(k.T_wk.numpy()[:3, 3] - true[k.index][:3, 3]) for k in frames.graph.keyframes]
            assert np.isfinite(frames.trajectory()).all()
    assert np.mean(off) < 0.003
