"""The displacement that explains differences of brightness: by hand on a ramp, and on a painted wall at right and wrong poses."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from torch import Tensor

from idfslam.alignment.displacement import compiled_displacement, displacement, level_of, plain_displacement
from idfslam.alignment.frame_motion import FrameMotion
from idfslam.alignment.image_pyramid import pyramid
from idfslam.alignment.landmarks import Landmarks, landmarks
from idfslam.alignment.sighting import Appearance, Sighting
from idfslam.geometry import se3
from idfslam.geometry.camera import Camera
from idfslam.sensing.rectification import RowTimes

CAMERA = Camera(320, 240, 280.0, 280.0, 159.5, 119.5)
EYE = torch.eye(4, dtype=torch.float64)


def appearance(colour: Tensor, depth: Tensor) -> Appearance:
    return Appearance(pyramid(colour.float().contiguous(), CAMERA, height=240, levels=4), depth.float(), CAMERA)


def wall(T_wc: Tensor, *, blur: float = 0.0, gain: float = 1.0, offset: float = 0.0) -> Appearance:
    """A wall 2 m ahead, painted in waves of 20 to 60 cm. blur: deviation [px]."""
    rays = CAMERA.rays(CAMERA.pixels()).double() @ T_wc[:3, :3].T
    depth = (2 - T_wc[2, 3]) / rays[..., 2]
    x, y, _ = (T_wc[:3, 3] + rays * depth[..., None]).unbind(-1)
    paint = 0.5 + 0.12 * torch.sin(11 * x + 3 * y) + 0.12 * torch.sin(19 * y - 5 * x) + 0.1 * torch.sin(31 * x + 1) * torch.cos(27 * y)
    if blur:
        paint = torch.from_numpy(cv2.GaussianBlur(paint.numpy(), (0, 0), blur))
    return appearance((gain * paint + offset)[..., None].expand(*paint.shape, 3), depth)


def turned(degrees: float) -> Tensor:
    return se3.exp(torch.tensor([0, 0, 0, 0, math.radians(degrees), 0], dtype=torch.float64))


@pytest.fixture(scope="module")
def marks() -> Landmarks:
    of_wall = wall(EYE)
    return landmarks(of_wall.levels, of_wall.depth, count=1500, least=0.005)


def test_it_is_measured_on_the_image_of_about_sixty_rows() -> None:
    frame = wall(EYE)
    assert frame.levels[level_of(frame)].camera.height == 60


def test_a_ramp_by_hand() -> None:
    """The coarse image rises by 0.004 a pixel. Landmarks are 0.006 brighter or darker than that: 1.5 pixels of 70 px focal length."""
    ramp = (0.2 + 0.001 * torch.arange(320.0)).expand(240, 320)[..., None].expand(240, 320, 3)
    frame = appearance(ramp, torch.full((240, 320), 2.0))
    coarse = frame.levels[2]
    u, v = (axis.flatten() for axis in torch.meshgrid(torch.arange(4.0, 76), torch.arange(4.0, 56), indexing="xy"))
    points = coarse.camera.rays(torch.stack([u, v], -1)) * 2.0
    diagonal = torch.arange(len(u)) % 72 + torch.arange(len(u)) // 72  # so that the mean of each part of the image stays
    off = 0.006 * (1 - 2 * (diagonal % 2))
    values = [level.at(level.camera.project(points)[0]) for level in frame.levels]
    of_ramp = Landmarks(points, [value[0] + off for value in values], [value[1:].contiguous() for value in values])
    seen, found = displacement(frame, of_ramp, EYE, EYE)
    assert seen == len(u) == 72 * 52 and coarse.camera.fx == 70
    assert found == pytest.approx(1.5 / 70, rel=0.02)
    nearer = replace(frame, depth=torch.where(torch.arange(320) < 208, frame.depth, 1.5))  # contradicts the right ones: 22 of 72 columns
    third = torch.where(diagonal % 6 < 2, 1.0, 0.5)  # a third is 1.5 pixels off, the others 0.75
    mixed = Landmarks(points, [value[0] + off * third for value in values], of_ramp.slopes)
    assert displacement(frame, mixed, EYE, EYE)[1] == pytest.approx(0.75 / 70, rel=0.1)
    assert displacement(nearer, mixed, EYE, EYE) == (len(u), pytest.approx(1.5 / 70, rel=0.1))  # 0.31 + 0.69 / 3 lie off: more than half
    assert displacement(replace(frame, depth=torch.full((240, 320), 1.5)), of_ramp, EYE, EYE) == (len(u), pytest.approx(80 / 70))


@pytest.mark.parametrize("degrees", [0.0, 0.7, 3.0])
@pytest.mark.parametrize("motion", [None, FrameMotion(RowTimes(0.02, 0.025, 0.01), np.array([0.3, -0.2, 0.1, 0.5, 1.0, -0.4]))])
def test_the_compiled_one_is_the_plain_one(marks: Landmarks, degrees: float, motion: FrameMotion | None) -> None:
    frame = wall(EYE, gain=0.8)
    compiled, plain = (
        form(Sighting(frame, marks, EYE, turned(degrees), 2, motion)) for form in (compiled_displacement, plain_displacement)
    )
    assert compiled[0] == plain[0] and compiled[1] == pytest.approx(plain[1], rel=1e-4, abs=1e-5)


def test_it_grows_with_the_error_and_not_with_blur_or_exposure(marks: Landmarks) -> None:
    off = {degrees: math.degrees(displacement(wall(turned(degrees)), marks, EYE, EYE)[1]) for degrees in (0.0, 0.5, 1.0, 3.0)}
    assert off[0.0] < 0.01 and 0.15 < off[0.5] < 0.5 and 0.3 < off[1.0] < 1.0 and off[3.0] > 0.9
    assert math.degrees(displacement(wall(EYE, gain=1.2, offset=-0.1), marks, EYE, EYE)[1]) < 0.01
    assert math.degrees(displacement(wall(EYE, blur=3.0), marks, EYE, EYE)[1]) < 0.2
    in_the_dark = [math.degrees(displacement(wall(turned(degrees), gain=0.35), marks, EYE, EYE)[1]) for degrees in (0.0, 3.0)]
    assert in_the_dark[0] < 0.01 and in_the_dark[1] > 0.9


def test_without_a_landmark_in_view_it_is_unknown(marks: Landmarks) -> None:
    assert displacement(wall(EYE), marks, EYE, turned(180.0)) == (0, 0.0)
    assert plain_displacement(Sighting(wall(EYE), marks, EYE, turned(180.0), 2)) == (0, 0.0)
