"""A bundle adjustment of points in a box, with known truth and known noise."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from idfslam.adjustment.bundle_adjustment import Problem
from idfslam.adjustment.camera_model import NAMES, CameraModel
from idfslam.adjustment.observations import Array, Observations, determined
from idfslam.adjustment.residuals import camera_points
from idfslam.geometry.camera import Camera

CAMERA = Camera(320, 240, 290.0, 288.0, 158.0, 121.0)
PIXEL, SHARE = 0.2, 0.003  # noise of the image [px] and of depth [1], as a share of it


def values(**given: float) -> Array:
    """(P,) deviations of a camera, zero where none is given."""
    return np.array([given.get(name, 0.0) for name in NAMES])


def walk(keyframes: int) -> Array:
    """(K, 4, 4) poses on an arc in front of the box, looking at it with turns about all axes."""
    s = np.linspace(-1, 1, keyframes)
    T = np.tile(np.eye(4), (keyframes, 1, 1))
    T[:, :3, :3] = Rotation.from_euler("yxz", np.stack([-0.5 * s, 0.15 * np.cos(5 * s), 0.4 * s], 1)).as_matrix()
    T[:, :3, 3] = np.stack([1.2 * s, 0.3 * np.sin(4 * s), 0.4 * np.cos(3 * s)], 1)
    return T


def true_problem(model: CameraModel, *, keyframes: int = 8, landmarks: int = 250, seed: int = 0, noise: float = 1.0) -> Problem:
    """The problem at its solution: the camera `model`, poses and points are true; what was measured has `noise` times PIXEL and SHARE."""
    rng = np.random.default_rng(seed)
    poses = walk(keyframes)
    points = rng.uniform([-1.6, -1.2, 1.8], [1.6, 1.2, 3.8], (landmarks, 3))
    landmark, keyframe = (index.ravel() for index in np.meshgrid(np.arange(landmarks), np.arange(keyframes), indexing="ij"))
    zeros = np.zeros(len(keyframe))
    flat, roots = np.zeros((len(keyframe), 2)), np.tile(np.eye(2) / PIXEL, (len(keyframe), 1, 1))
    every = Observations(keyframe, landmark, flat, roots, zeros, zeros, flat)
    p = camera_points(poses, points, every)
    uv = model.project(p)[0]
    c = CAMERA
    inside = (uv > [0, 0]).all(1) & (uv < [c.width - 1, c.height - 1]).all(1)
    uv = uv + noise * PIXEL * rng.standard_normal(uv.shape)
    reading = p[:, 2].copy()
    for _ in range(8):  # the reading that stands for this depth
        reading += p[:, 2] - model.depth(uv, reading)[0]
    sigma = SHARE * reading
    reading = reading + noise * sigma * rng.standard_normal(len(reading))
    seen = replace(every, uv=uv, reading=reading, reading_sigma=sigma)[inside & (p[:, 2] > 0.3)]
    points, seen = determined(points, seen)
    return Problem(model, poses, points, seen, np.arange(keyframes) == 0, np.array([name != "depth_scale" for name in NAMES]))


def perturbed(problem: Problem, *, shift: float = 0.02, turn: float = 0.01, seed: int = 1) -> Problem:
    """The problem with the stated camera, and poses and points that are off by a normal distribution [m, rad]."""
    rng = np.random.default_rng(seed)
    poses = problem.poses.copy()
    poses[1:, :3, :3] = poses[1:, :3, :3] @ Rotation.from_rotvec(turn * rng.standard_normal((len(poses) - 1, 3))).as_matrix()
    poses[1:, :3, 3] += shift * rng.standard_normal((len(poses) - 1, 3))
    points = problem.points + shift * rng.standard_normal(problem.points.shape)
    return replace(problem, poses=poses, points=points, model=CameraModel.as_stated(problem.model.stated))
