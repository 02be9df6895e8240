"""`--preset paper`: the values of Sec. VI-A, and a run with them in small."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from idfslam.config import PAPER, Config, preset
from idfslam.datasets import open_recording
from idfslam.frame import FrameResult
from idfslam.mapping.field import Field
from idfslam.mapping.objectives import RenderingObjective, loss_weights
from idfslam.slam import Slam


def test_values_of_the_paper() -> None:
    assert preset("paper") is PAPER
    field, mapper, keyframes, tracker, finetune = PAPER.field, PAPER.mapper, PAPER.keyframes, PAPER.tracker, PAPER.finetune
    assert (field.encoding, field.layers, field.width, field.truncation) == ("positional", 8, 256, 0.10)
    assert (mapper.supervision, mapper.pixels, mapper.samples + mapper.importance_samples, mapper.cells) == ("rendering", 1024, 144, 8)
    assert (mapper.learning_rate, mapper.pose_learning_rate, mapper.pose_decay, mapper.pose_decay_every) == (0.005, 0.005, 0.7, 10)
    assert (mapper.every, mapper.redraw, mapper.active_sampling, mapper.pose_optimisation) == (0, 1, True, True)
    assert (keyframes.cull, keyframes.covisible, keyframes.replay, keyframes.replay_connected) == (0.5, 0.3, 10, 0)
    assert (tracker.consensus, tracker.subsets, tracker.subset_share, tracker.refits) == ("random", 100, 0.05, 0)
    assert (tracker.mutual, tracker.plane_steps, tracker.min_agreement) == (False, 0, 0.0)
    assert (tracker.matches, tracker.grid, finetune.keyframes, finetune.learning_rate) == (200, 4, 10, 1e-4)
    assert PAPER.front_end == "registration"


def test_losses_are_those_of_the_renderers_paper() -> None:
    weights = loss_weights(PAPER.mapper)
    assert (weights.photometric, weights.free_space, weights.truncation) == (0.1, 10.0, 6000.0)
    assert RenderingObjective(PAPER.mapper, PAPER.field.truncation).march.sharpness == 1 / PAPER.field.truncation


def test_the_network_of_figure_3() -> None:
    # Position: 3 + 3 * 2 * 8 = 51 numbers; direction: 3 + 3 * 2 * 4 = 27.
    field = Field(PAPER.field)
    assert [layer.in_features for layer in field.trunk] == [51, 256, 256, 256, 256 + 51, 256, 256, 256]
    assert field.colour_head[0].in_features == 256 + 27
    assert field.colour_head[0].out_features == 128


def reduced() -> Config:
    """The paper's system, small enough for a test."""
    field = replace(PAPER.field, layers=4, width=64, skip=3)
    sizes = {"pixels": 96, "samples": 16, "importance_samples": 8, "first_iterations": 200, "iterations": 12, "pose_iterations": 10}
    return replace(
        PAPER,
        field=field,
        mapper=replace(PAPER.mapper, pose_learning_rate=0.001, **sizes),  # so small a map is too coarse for steps of 5 mm
        keyframes=replace(PAPER.keyframes, translation=0.03, rotation=3.0, cull=1.0),
        tracker=replace(PAPER.tracker, query_stride=4, target_stride=2),
        finetune=replace(PAPER.finetune, keyframes=2, pixels=64),
    )


@pytest.fixture(scope="module")
def processed(box_recording: Path) -> tuple[Slam, list[FrameResult], np.ndarray]:
    """The box recording through the paper's system, its results and the frames' positions' errors [m]."""
    recording = open_recording(box_recording)
    slam = Slam(reduced())
    results = [slam.process(recording[i]) for i in range(len(recording))]
    truth = np.linalg.inv(recording.ground_truth[0]) @ recording.ground_truth
    return slam, results, np.linalg.norm(slam.trajectory()[:, :3, 3] - truth[:, :3, 3], axis=-1)


@pytest.mark.slow
def test_it_follows_the_camera(processed: tuple[Slam, list[FrameResult], np.ndarray]) -> None:
    _, results, errors = processed
    assert not [r.index for r in results if r.status.value == "lost"]
    assert errors.max() < 0.06, errors


@pytest.mark.slow
def test_each_frame_refines_map_or_tracker(processed: tuple[Slam, list[FrameResult], np.ndarray]) -> None:
    slam, results, _ = processed
    assert results[0].keyframe
    assert "pose_total" not in results[0].losses  # the first frame is the world
    stored = 0
    for result in results:
        stored += result.keyframe
        names = set(result.losses)
        if result.keyframe:
            assert "total" in names
        else:
            assert names == (set() if stored < 2 else {"finetune_photometric", "finetune_depth", "finetune_correspondence"})
        assert all(math.isfinite(value) for value in result.losses.values())
    assert len(slam.graph.keyframes) == stored >= 3


@pytest.mark.slow
def test_two_runs_give_one_result(box_recording: Path) -> None:
    recording, config = open_recording(box_recording, frames=4), reduced()
    config = replace(config, keyframes=replace(config.keyframes, translation=0.01))

    def once() -> tuple[np.ndarray, torch.Tensor]:
        slam = Slam(config)
        for i in range(len(recording)):
            slam.process(recording[i])
        return slam.trajectory(), slam.mapper.field.sdf_head.weight.clone()

    (poses, weights), (poses_again, weights_again) = once(), once()
    assert np.array_equal(poses, poses_again)
    assert torch.equal(weights, weights_again)
