"""The distances of a frame's points to the map: asked where the points have moved far, linear in between."""

import numpy as np
import pytest
import torch
from torch import Tensor

from helpers.three_walls import CORNER, EYE, aligner, taught, view
from idfslam.alignment.frame_motion import FrameMotion
from idfslam.alignment.motion import moved
from idfslam.alignment.surface_distances import SurfaceDistances
from idfslam.compute.backend import plain_torch
from idfslam.mapping.mapper import Mapper
from idfslam.sensing.rectification import RowTimes


def shifted(metres: float) -> Tensor:
    return moved(EYE, torch.tensor([0, 0, metres, 0, 0, 0], dtype=torch.float64))


def test_the_map_is_asked_again_beyond_two_millimetres() -> None:
    mapper: Mapper = taught(CORNER)
    seen, of_map, asked = view(CORNER, EYE), aligner(mapper), [0]
    surface = of_map.surface(seen.images, seen.camera)

    def query(points: Tensor) -> tuple[Tensor, Tensor]:
        asked[0] += 1
        return of_map.query(points)

    distances = SurfaceDistances(surface, query, of_map.truncation, 4.0)
    distances.term(EYE, 0.01, None)
    near = distances.term(shifted(0.0015), 0.01, None)
    assert asked[0] == 1
    exact = SurfaceDistances(surface, of_map.query, of_map.truncation, 4.0).term(shifted(0.0015), 0.01, None)
    torch.testing.assert_close(near.H, exact.H, rtol=0, atol=0.02 * float(exact.H.abs().max()))
    assert abs(near.rmse - exact.rmse) < 0.0002
    distances.term(shifted(0.003), 0.01, None)
    assert asked[0] == 2


def test_the_compiled_form_is_the_plain_one() -> None:
    seen, of_map = view(CORNER, EYE), aligner(taught(CORNER))
    surface, T = (
        of_map.surface(seen.images, seen.camera),
        moved(EYE, torch.tensor([0.02, -0.01, 0.01, 0.01, 0.02, -0.01], dtype=torch.float64)),
    )
    still, motion = None, FrameMotion(RowTimes(0.03, 0.02, 0.01), np.array([0.4, -0.3, 0.2, 0.1, 0.2, -0.15]))
    nearby = moved(T, torch.tensor([0.001, 0, 0, 0, 0, 0], dtype=torch.float64))
    for within, poses in ((still, (T, nearby)), (motion, (T, nearby))):  # the map is asked at the first pose
        compiled, plain = (SurfaceDistances(surface, of_map.query, of_map.truncation, 4.0) for _ in range(2))
        for pose in poses:
            found = compiled.term(pose, 0.01, within)
            with plain_torch():
                expected = plain.term(pose, 0.01, within)
            largest = np.abs(expected.sums.H).max()
            np.testing.assert_allclose(found.sums.H, expected.sums.H, rtol=0, atol=1e-4 * largest)
            np.testing.assert_allclose(found.sums.b, expected.sums.b, rtol=0, atol=1e-4 * np.abs(expected.sums.b).max())
            assert found.rmse == pytest.approx(expected.rmse, rel=1e-4)
            assert found.overlap == pytest.approx(expected.overlap, abs=1e-3)
