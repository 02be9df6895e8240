"""The distances of a frame's points to the map: asked where the points have moved far, linear in between."""

import torch
from torch import Tensor

from helpers.three_walls import CORNER, EYE, aligner, taught, view
from idfslam.alignment.motion import moved
from idfslam.alignment.surface_distances import SurfaceDistances
from idfslam.mapping.mapper import Mapper


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
