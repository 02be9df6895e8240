"""Brightness of landmarks: the normal equations, compiled and plain, against finite differences."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from torch import Tensor

from idfslam.alignment.exposure import exposure
from idfslam.alignment.frame_motion import FrameMotion
from idfslam.alignment.image_pyramid import pyramid
from idfslam.alignment.landmarks import Landmarks, landmarks
from idfslam.alignment.photometric import photometric_term, plain_photometric_term
from idfslam.alignment.sighting import Appearance, Sighting
from idfslam.geometry import se3
from idfslam.geometry.camera import Camera
from idfslam.sensing.rectification import RowTimes

CAMERA = Camera(96, 72, 80.0, 80.0, 47.5, 35.5)
EYE = torch.eye(4, dtype=torch.float64)


def pose(*increment: float) -> Tensor:
    return se3.exp(torch.tensor(increment, dtype=torch.float64))


def view(T_wc: Tensor, *, noise: float = 0.0) -> tuple[Tensor, Tensor]:
    """Colour (H, W, 3) and depth (H, W) of a wall 2 m ahead that leans a quarter, smoothly painted: z = 2 + x / 4."""
    rays = CAMERA.rays(CAMERA.pixels()).double() @ T_wc[:3, :3].T
    origin = T_wc[:3, 3]
    depth = (2 + origin[0] / 4 - origin[2]) / (rays[..., 2] - rays[..., 0] / 4)
    p = origin + rays * depth[..., None]
    paint = 0.5 + 0.2 * torch.sin(5 * p[..., 0] + 2) + 0.15 * torch.sin(7 * p[..., 1]) * torch.cos(3 * p[..., 0])
    paint = paint + noise * torch.randn(paint.shape, generator=torch.Generator().manual_seed(0))
    return paint[..., None].expand(*paint.shape, 3).float().contiguous(), depth.float()


def appearance(T_wc: Tensor, *, gain: float = 1.0, offset: float = 0.0, noise: float = 0.0) -> Appearance:
    colour, depth = view(T_wc, noise=noise)
    return Appearance(pyramid(gain * colour + offset, CAMERA, height=72, levels=3), depth, CAMERA)


def marks_at(T_wk: Tensor) -> Landmarks:
    frame = appearance(T_wk)
    return landmarks(frame.levels, frame.depth, count=400, least=0.005)


@pytest.mark.parametrize("level", [0, 1, 2])
@pytest.mark.parametrize("noise", [0.0, 0.03])
def test_the_compiled_term_is_the_plain_one(level: int, noise: float) -> None:
    T_wk, T_wc = pose(0.1, 0.02, 0, 0.01, 0.05, 0), pose(0.13, 0, 0.04, 0.0, 0.03, 0.02)
    marks = marks_at(T_wk)
    frame = appearance(pose(0.14, 0, 0.04, 0.0, 0.035, 0.02), gain=0.9, offset=0.05, noise=noise)
    depth = frame.depth.clone()
    depth[:20] = 0  # holes in the frame's depth hide nothing,
    depth[:, 70:] = 1.0  # an obstacle does
    frame = replace(frame, depth=depth)
    found = photometric_term(Sighting(frame, marks, T_wk, T_wc, level), floor=0.002, widest=3.0)
    plain = plain_photometric_term(Sighting(frame, marks, T_wk, T_wc, level), floor=0.002, widest=3.0)
    assert found.seen == plain.seen
    assert 50 < found.seen < len(marks.points) - 20
    assert found.noise == pytest.approx(plain.noise, rel=2e-3)
    torch.testing.assert_close(found.H, plain.H, rtol=0, atol=5e-3 * float(plain.H.abs().max()))
    torch.testing.assert_close(found.b, plain.b, rtol=0, atol=5e-3 * float(plain.b.abs().max()))
    torch.testing.assert_close(found.H, found.H.T)


@pytest.mark.parametrize("level", [0, 2])
def test_the_compiled_term_of_a_moving_frame_is_the_plain_one(level: int) -> None:
    T_wk, T_wc = pose(0.1, 0.02, 0, 0.01, 0.05, 0), pose(0.13, 0, 0.04, 0.0, 0.03, 0.02)
    marks, frame = marks_at(T_wk), appearance(pose(0.14, 0, 0.04, 0.0, 0.035, 0.02))
    motion = FrameMotion(RowTimes(0.03, 0.02, -0.01), np.array([0.3, -0.2, 0.1, 0.8, -1.0, 1.5]))
    found = photometric_term(Sighting(frame, marks, T_wk, T_wc, level, motion), floor=0.002, widest=3.0, moments=True)
    plain = plain_photometric_term(Sighting(frame, marks, T_wk, T_wc, level, motion), floor=0.002, widest=3.0, moments=True)
    still = photometric_term(Sighting(frame, marks, T_wk, T_wc, level), floor=0.002, widest=3.0, moments=True)
    assert found.seen == plain.seen
    assert found.noise == pytest.approx(plain.noise, rel=2e-3)
    for k in range(3):
        np.testing.assert_allclose(found.sums.H[k], plain.sums.H[k], rtol=0, atol=5e-3 * float(np.abs(plain.sums.H[k]).max()))
    assert not torch.allclose(found.b, still.b, rtol=0.05)  # the motion matters


def moved(T: Tensor, delta: Tensor) -> Tensor:
    """Shifted by delta[:3] and turned by delta[3:] about the camera's centre, both along world axes."""
    turn = se3.exp(torch.cat([torch.zeros(3, dtype=torch.float64), delta[3:]]))
    out = T.clone()
    out[:3, :3], out[:3, 3] = turn[:3, :3] @ T[:3, :3], T[:3, 3] + delta[:3]
    return out


def test_jacobian_against_finite_differences() -> None:
    # One landmark at a time. Alone, exposure explains it whole (r = 0); so H = w J J^T is read from it, with w = 1 / floor^2 = 1.
    T_wk, T_wc = pose(0.1, 0.02, 0, 0.01, 0.05, 0), pose(0.13, 0, 0.04, 0.0, 0.03, 0.02)
    frame, marks = appearance(T_wc), marks_at(T_wk)
    step = 0.0125  # about a pixel: the image is piecewise bilinear, its slopes central differences over two pixels
    checked = 0
    for i in range(0, len(marks.points), 7):
        one = Landmarks(marks.points[i : i + 1], [x[i : i + 1] for x in marks.luminance], [x[:, i : i + 1] for x in marks.slopes])
        term = photometric_term(Sighting(frame, one, T_wk, T_wc, 0), floor=1.0, widest=3.0)
        if term.seen == 0:
            continue

        def brightness(T: Tensor, one: Landmarks = one) -> float:
            points_c = se3.transform(se3.inverse(T) @ T_wk, one.points.double())
            return float(frame.levels[0].at(CAMERA.project(points_c)[0].float())[0])

        deltas = step * torch.eye(6, dtype=torch.float64)
        J = torch.tensor([(brightness(moved(T_wc, d)) - brightness(moved(T_wc, -d))) / (2 * step) for d in deltas], dtype=torch.float64)
        torch.testing.assert_close(term.H, torch.outer(J, J), rtol=0, atol=0.15 * float(J @ J) + 2e-3)
        checked += 1
    assert checked > 20


def test_the_step_goes_back_to_the_true_pose() -> None:
    # Gauss-Newton on brightness alone, 1.4 cm and half a degree away, on the finest level: a few steps find the truth.
    T_wk, truth = pose(0.1, 0.02, 0, 0.01, 0.05, 0), pose(0.13, 0, 0.04, 0.0, 0.03, 0.02)
    frame, marks = appearance(truth), marks_at(T_wk)
    T = moved(truth, torch.tensor([0.01, -0.01, 0.0, 0.004, 0.006, -0.005], dtype=torch.float64))
    for _ in range(8):
        term = photometric_term(Sighting(frame, marks, T_wk, T, 0), floor=0.002, widest=3.0)
        T = moved(T, torch.linalg.solve(term.H, term.b))
    error = se3.inverse(truth) @ T
    assert float(error[:3, 3].norm()) < 0.003
    assert float(se3.angle(error)) < 0.0015


def test_exposure_is_taken_out() -> None:
    T_wk, T_wc = EYE, pose(0.03, 0, 0.02, 0, 0.01, 0)
    marks = marks_at(T_wk)
    same = photometric_term(Sighting(appearance(T_wc), marks, T_wk, T_wc, 0), floor=1e-6, widest=3.0, even=True)
    other = photometric_term(Sighting(appearance(T_wc, gain=1.2, offset=-0.1), marks, T_wk, T_wc, 0), floor=1e-6, widest=3.0, even=True)
    assert other.seen == same.seen
    assert other.noise == pytest.approx(1.2 * same.noise, rel=0.05)


@pytest.mark.parametrize(
    ("gain", "offset", "expected"),
    [(0.35, 0.0, 0.35), (0.9, 0.0, 0.9), (2.5, 0.0, 2.5), (0.35, 0.3, 0.7), (3.0, -1.0, 1.4), (0.0, 0.01, 0.14)],
)
def test_contrast_is_exposure_only_as_far_as_the_mean_says_so(gain: float, offset: float, expected: float) -> None:
    """A lamp that goes out takes brightness and contrast; blur takes contrast alone, and is no change of exposure beyond 0.7."""
    target = torch.from_numpy(np.random.default_rng(0).uniform(0.2, 0.75, 500)).float()
    inside = torch.arange(500) % 3 > 0
    found, rest = exposure(target, gain * target + offset, inside)
    assert float(found) == pytest.approx(expected, rel=1e-3)
    assert float((found * target + rest)[inside].mean()) == pytest.approx(float((gain * target + offset)[inside].mean()))


@pytest.mark.parametrize("gain", [0.3, 2.0])
def test_the_light_that_changes_hides_nothing(gain: float) -> None:
    """The compiled term is the plain one; the differences that are left are as many times as large as the light."""
    T_wk, T_wc = EYE, pose(0.03, 0, 0.02, 0, 0.01, 0)
    marks = marks_at(T_wk)
    same, other = (Sighting(appearance(T_wc, gain=g), marks, T_wk, T_wc, 0) for g in (1.0, gain))
    found, plain = photometric_term(other, floor=1e-6, widest=3.0), plain_photometric_term(other, floor=1e-6, widest=3.0)
    assert found.noise == pytest.approx(plain.noise, rel=2e-3, abs=5e-7)  # of brightness in 32 bits, whose steps are 6e-8
    assert found.noise == pytest.approx(gain * photometric_term(same, floor=1e-6, widest=3.0).noise, rel=0.05)


def test_noise_is_that_of_the_images() -> None:
    # Noise of 0.03 a pixel, weighted by bilinear interpolation: its standard deviation lies between 0.03 / 2 and 0.03.
    marks, T_wc = marks_at(EYE), pose(0.031, 0, 0.02, 0, 0.01, 0)
    noisy = photometric_term(Sighting(appearance(T_wc, noise=0.03), marks, EYE, T_wc, 0), floor=0.001, widest=3.0)
    assert 0.015 < noisy.noise < 0.03
    assert photometric_term(Sighting(appearance(T_wc), marks, EYE, T_wc, 0), floor=0.01, widest=3.0).noise == 0.01  # the floor


@pytest.mark.parametrize("build", [photometric_term, plain_photometric_term])
def test_a_blurred_image_counts_for_less(build) -> None:  # type: ignore[no-untyped-def]
    colour = torch.rand(72, 96, 1, generator=torch.Generator().manual_seed(0)).repeat(1, 1, 3)
    depth = torch.full((72, 96), 2.0)
    marks = landmarks(pyramid(colour, CAMERA, height=72, levels=1), depth, count=400)
    information = []
    for width in (1, 3, 7):  # pixels of a sideways motion
        blurred = torch.from_numpy(cv2.blur(colour.numpy(), (width, 1)))
        frame = Appearance(pyramid(blurred, CAMERA, height=72, levels=1), depth, CAMERA)
        information.append(float(build(Sighting(frame, marks, EYE, EYE, 0), floor=0.02, widest=3.0).H.trace()))
    assert information[1] < information[0] / 10
    assert information[2] < information[1]


@pytest.mark.parametrize("build", [photometric_term, plain_photometric_term])
def test_a_camera_turned_away_sees_nothing(build) -> None:  # type: ignore[no-untyped-def]
    term = build(Sighting(appearance(EYE), marks_at(EYE), EYE, pose(0, 0, 0, 0, 3.1, 0), 0), floor=0.01, widest=3.0)
    assert term.seen == 0
    assert not term.H.any()
    assert not term.b.any()
