"""Covariances of adjusted poses: honest also where measurements share errors, as those of a landmark or of a part of an image do."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from helpers.point_problem import CAMERA, PIXEL, true_problem
from idfslam.adjustment.bundle_adjustment import Adjusted, Problem, adjust
from idfslam.adjustment.camera_model import NAMES, CameraModel
from idfslam.adjustment.shared_errors import PoseCovariances
from idfslam.geometry import se3

PARTS = 3


def adjusted(bend: float, seed: int) -> tuple[Adjusted, Problem]:
    """Adjusted with the true camera, and the truth. bend: each part of each image is off by a normal distribution [px]."""
    true = true_problem(CameraModel.as_stated(CAMERA), landmarks=300, seed=seed)
    true = replace(true, estimated=np.zeros(len(NAMES), bool))
    rng = np.random.default_rng([seed, 1])
    shifts = bend * rng.standard_normal((len(true.poses), PARTS, PARTS, 2))
    column, row = (true.seen.uv / [CAMERA.width, CAMERA.height] * PARTS).astype(int).clip(0, PARTS - 1).T
    bent = replace(true, seen=replace(true.seen, uv=true.seen.uv + shifts[true.seen.keyframe, row, column]))
    return adjust(bent), true


def nees(bend: float) -> tuple[float, float]:
    """Mean squared errors of poses in units of covariances, over six draws: of the noise alone, and with what is shared."""
    of_noise, shared = [], []
    for seed in range(6):
        found, true = adjusted(bend, seed)
        covariances = PoseCovariances(found)
        for k in range(1, len(true.poses)):
            off = se3.log(torch.from_numpy(np.linalg.inv(found.problem.poses[k]) @ true.poses[k])).numpy()
            of_noise.append(off @ np.linalg.solve(found.pose_covariance(k), off) / 6)
            shared.append(off @ np.linalg.solve(covariances.of(k), off) / 6)
    return float(np.mean(of_noise)), float(np.mean(shared))


def test_noise_alone_is_told_with_room_to_spare() -> None:
    of_noise, shared = nees(0.0)
    assert 0.6 < of_noise < 1.4  # 0.85 here
    assert 0.2 < shared < 0.6  # 0.33: what is independent counts three times


def test_parts_of_images_that_are_bent_make_covariances_larger() -> None:
    of_noise, shared = nees(PIXEL)
    assert of_noise > 8  # 10.4 here
    assert 0.5 < shared < 2.0  # 1.6


def test_the_first_keyframe_has_no_error() -> None:
    found, _ = adjusted(0.0, 0)
    assert not PoseCovariances(found).of(0).any()


def test_covariances_are_symmetric_and_positive() -> None:
    covariance = PoseCovariances(adjusted(1.0, 0)[0]).of(3)
    assert covariance == pytest.approx(covariance.T)
    assert np.linalg.eigvalsh(covariance).min() > 0
