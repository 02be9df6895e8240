"""Images of analytic distance functions: cones skip free space and nothing else."""

import pytest
import torch
from torch import Tensor

from idfslam.geometry.camera import Camera
from idfslam.mapping.sphere_tracing import march_cones, trace, trace_image
from idfslam.mapping.tsdf_rendering import world_rays

CAMERA = Camera(100, 76, 90.0, 90.0, 49.5, 37.5)  # neither side a multiple of the tiles
TR = 0.06
SCENES = {"sphere before a wall": (0.3, [0.1, 0.0, 1.5]), "thin rod": (0.012, [0.0, 0.05, 1.0])}


def scene(name: str) -> tuple[float, Tensor]:
    radius, centre = SCENES[name]
    return radius, torch.tensor(centre)


def sdf_of(name: str):  # type: ignore[no-untyped-def]
    radius, centre = scene(name)
    axes = [0, 2] if "rod" in name else [0, 1, 2]  # the rod stands upright

    def sdf(points: Tensor) -> Tensor:
        ball = (points - centre)[:, axes].norm(dim=-1) - radius
        return (torch.minimum(ball, 3.0 - points[:, 2]) / TR).clamp(-1, 1)

    return sdf


@pytest.mark.parametrize("name", SCENES)
def test_images_are_those_of_single_rays(name: str) -> None:
    sdf = sdf_of(name)
    image = trace_image(sdf, lambda points, directions: points, torch.eye(4), CAMERA, far=5, truncation=TR)
    origins, directions = world_rays(torch.eye(4), CAMERA, CAMERA.pixels().view(-1, 2))
    alone = trace(sdf, origins, directions, near=0.05, far=5, truncation=TR).view(CAMERA.height, CAMERA.width)
    same = (image.depth - alone).abs() < 1e-3
    assert same.float().mean() > 0.995  # what rays graze depends on where they happen to stop
    assert (image.depth > 0).all()
    assert torch.allclose(image.colour[..., 2], image.depth, atol=1e-5)


def test_depth_is_exact() -> None:
    image = trace_image(sdf_of("sphere before a wall"), lambda p, d: p, torch.eye(4), CAMERA, far=5, truncation=TR)
    assert image.depth[0, 0] == pytest.approx(3.0, abs=1e-3)
    # the ray (5.5/90, 0, 1) t meets |p - (0.1, 0, 1.5)| = 0.3 at t = 1.2026
    t = torch.linspace(0, 2, 2_000_001, dtype=torch.float64)
    x, y = (55 - 49.5) / 90, (37 - 37.5) / 90
    distance = ((t * x - 0.1) ** 2 + (t * y) ** 2 + (t - 1.5) ** 2).sqrt() - 0.3
    assert image.depth[37, 55] == pytest.approx(float(t[distance < 0][0]), abs=1e-3)


def test_cones_end_before_the_surface() -> None:
    sdf = sdf_of("sphere before a wall")
    directions = torch.tensor([[0.1 / 1.5, 0.0, 1.0], [-0.5, 0.0, 1.0]])
    free = march_cones(sdf, torch.zeros(2, 3), directions, 0.01, near=0.05, far=5, truncation=TR)
    assert 1.05 < float(free[0]) < 1.2  # the sphere begins at 1.2
    assert 2.8 < float(free[1]) < 3.0


def test_rays_pass_through_what_nobody_observed() -> None:
    """The sphere is not to be believed: the wall behind it shows."""
    origins = torch.tensor([0.1, 0.0, 1.5])
    image = trace_image(
        sdf_of("sphere before a wall"),
        lambda points, directions: points,
        torch.eye(4),
        CAMERA,
        far=5,
        truncation=TR,
        observed=lambda points: (points - origins).norm(dim=-1) > 0.35,
    )
    torch.testing.assert_close(image.depth, torch.full_like(image.depth, 3.0), atol=2e-3, rtol=0)
    nothing = trace_image(sdf_of("thin rod"), lambda p, d: p, torch.eye(4), CAMERA, far=5, truncation=TR, observed=lambda p: p[:, 0] > 9)
    assert not nothing.depth.any()
