"""The whole system on the box room: repeatable, one pose a frame, a lost frame is not mapped and tracking recovers."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from box_room import BOX_FRAMES, box_poses

from idfslam.config import FAST
from idfslam.datasets import Dataset, open_recording
from idfslam.errors import ConfigError
from idfslam.frame import Frame, Status
from idfslam.geometry import se3
from idfslam.mapping.saved_map import load_map
from idfslam.slam import Slam

CONFIG = replace(FAST, device="cpu", mapper=replace(FAST.mapper, final_updates=2))
BLANK = 6  # the frame that is blanked in one of the runs


@pytest.fixture(scope="module")
def recording(box_recording: Path) -> Dataset:
    return open_recording(box_recording)


def processed(recording: Dataset, *, blank: int | None = None) -> tuple[Slam, list]:
    slam = Slam(CONFIG)
    results = []
    for i, frame in enumerate(recording):
        results.append(slam.process(Frame.blank(i, frame.timestamp, frame.camera) if i == blank else frame))
    return slam, results


@pytest.fixture(scope="module")
def whole(recording: Dataset) -> tuple[Slam, list]:
    return processed(recording)


@pytest.fixture(scope="module")
def interrupted(recording: Dataset) -> tuple[Slam, list]:
    return processed(recording, blank=BLANK)


def relative_truth() -> np.ndarray:
    """True poses in the world of the first camera."""
    poses = box_poses()
    return np.linalg.inv(poses[0]) @ poses


def test_two_runs_with_one_seed_are_identical(recording: Dataset, whole: tuple[Slam, list]) -> None:
    again, _ = processed(recording)
    assert np.array_equal(again.trajectory(), whole[0].trajectory())
    state, other = again.mapper.field.state_dict(), whole[0].mapper.field.state_dict()
    assert all(torch.equal(state[name], other[name]) for name in other)


def test_one_pose_a_frame(whole: tuple[Slam, list]) -> None:
    slam, results = whole
    trajectory = slam.trajectory()
    assert trajectory.shape == (BOX_FRAMES, 4, 4)
    assert np.array_equal(trajectory[0], np.eye(4))
    assert [result.index for result in results] == list(range(BOX_FRAMES))
    assert np.abs(trajectory[:, :3, 3] - relative_truth()[:, :3, 3]).max() < 0.02
    assert slam.statuses() == [Status.OK] * BOX_FRAMES


def test_frames_follow_their_keyframes(recording: Dataset) -> None:
    slam, _ = processed(recording)
    before, views = slam.trajectory(), slam.graph.views()
    T = se3.exp(torch.tensor([0.1, 0.2, 0.3, 0.1, 0.0, 0.0], dtype=torch.float64))
    for keyframe in slam.graph.keyframes:
        keyframe.T_wk = T @ keyframe.T_wk
    assert np.allclose(slam.trajectory(), T.numpy() @ before, atol=1e-12)
    assert all(np.allclose(moved.T_wc, T.numpy() @ view.T_wc) for moved, view in zip(slam.graph.views(), views))


def test_blank_frame_is_lost_and_not_mapped(interrupted: tuple[Slam, list]) -> None:
    slam, results = interrupted
    blank = results[BLANK]
    assert blank.status is Status.LOST
    assert not blank.keyframe
    assert blank.losses == {}
    assert BLANK not in [keyframe.index for keyframe in slam.graph.keyframes]
    assert np.allclose(blank.T_wc, results[BLANK - 1].T_wc @ np.linalg.inv(results[BLANK - 2].T_wc) @ results[BLANK - 1].T_wc, atol=1e-6)


def test_tracking_recovers_after_a_blank_frame(interrupted: tuple[Slam, list]) -> None:
    slam, results = interrupted
    assert all(result.status is Status.OK for result in results[BLANK + 1 :])
    errors = np.linalg.norm(slam.trajectory()[:, :3, 3] - relative_truth()[:, :3, 3], axis=-1)
    assert np.delete(errors, BLANK).max() < 0.02


def test_blank_first_frame_waits_for_depth(recording: Dataset) -> None:
    slam = Slam(CONFIG)
    first = slam.process(Frame.blank(0, 0.0, recording.camera))
    assert (first.status, first.keyframe) == (Status.LOST, False)
    second = slam.process(recording[1])
    assert (second.status, second.keyframe) == (Status.OK, True)
    assert np.array_equal(second.T_wc, np.eye(4))
    assert len(slam.trajectory()) == 2


def test_finish_twice_is_finish_once(recording: Dataset) -> None:
    slam = Slam(CONFIG)
    slam.process(recording[0])
    before = slam.mapper.field.encoding.tables.clone()
    slam.finish()
    polished = slam.mapper.field.encoding.tables.clone()
    assert not torch.equal(polished, before)
    slam.finish()
    assert torch.equal(slam.mapper.field.encoding.tables, polished)
    Slam(CONFIG).finish()  # nothing was processed: nothing to do


def test_mesh_covers_what_was_seen_though_keyframes_were_culled(whole: tuple[Slam, list], recording: Dataset) -> None:
    slam, _ = whole
    mesh = slam.mesh(0.05)
    last = slam.trajectory()[-1]
    local = (mesh.vertices - last[:3, 3]) @ last[:3, :3]
    camera = recording.camera
    u = local[:, 0] / local[:, 2] * camera.fx + camera.cx
    v = local[:, 1] / local[:, 2] * camera.fy + camera.cy
    inside = (local[:, 2] > 0) & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    # Vertices 5 cm apart or less on walls 1 to 2.5 m away (f = 140 px): one in every patch of 16 x 16 pixels.
    patches = np.unique(np.stack([u[inside] // 16, v[inside] // 16], -1), axis=0)
    assert len(patches) > 0.95 * (160 // 16) * (120 // 16)


def test_saved_map_shows_the_same(whole: tuple[Slam, list], recording: Dataset, tmp_path: Path) -> None:
    slam, _ = whole
    slam.save_map(tmp_path / "map.safetensors")
    colour, depth = load_map(tmp_path / "map.safetensors").render(slam.trajectory()[7], recording.camera)
    frame = recording[7]
    assert np.median(np.abs(depth - frame.depth)) < 0.01
    assert np.abs(colour - frame.colour).mean() < 0.1


@pytest.mark.skipif(torch.cuda.is_available(), reason="this machine has a CUDA device")
def test_cuda_without_cuda_is_refused() -> None:
    with pytest.raises(ConfigError, match="--device cuda"):
        Slam(replace(FAST, device="cuda"))
