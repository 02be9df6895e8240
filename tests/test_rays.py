"""Pixels to samples: the compiled forms against the plain ones."""

from types import SimpleNamespace

import pytest
import torch

from idfslam.geometry import se3
from idfslam.geometry.camera import Camera
from idfslam.mapping.active_sampling import compiled_group_pixels, plain_group_pixels
from idfslam.mapping.ray_samples import compiled_sample_points, plain_sample_points
from idfslam.mapping.rays import Rays, compiled_cast, plain_cast

CAMERA = Camera(47, 33, 40.0, 42.0, 22.5, 16.25)


def view(seed: int = 0) -> SimpleNamespace:
    """A slanted wall with a step in it, holes in its depth, from somewhere."""
    g = torch.Generator().manual_seed(seed)
    v, u = torch.meshgrid(torch.arange(33.0), torch.arange(47.0), indexing="ij")
    depth = 1.5 + 0.01 * u + 0.004 * v + 0.8 * (u > 30)
    depth[torch.rand(33, 47, generator=g) < 0.1] = 0
    T_wk = se3.exp(torch.randn(6, generator=g, dtype=torch.float64))
    return SimpleNamespace(T_wk=T_wk, camera=CAMERA, depth=depth, colour=torch.rand(33, 47, 3, generator=g))


@pytest.mark.parametrize("cells", [1, 4, 8])
def test_pixels_are_grouped_alike(cells: int) -> None:
    allowed = view().depth > 0
    found, plain = compiled_group_pixels(allowed, cells), plain_group_pixels(allowed, cells)
    assert torch.equal(found.order, plain.order) and found.order.dtype == plain.order.dtype
    assert torch.equal(found.starts, plain.starts) and torch.equal(found.counts, plain.counts)


def test_no_pixel_is_grouped_where_none_is_allowed() -> None:
    found = compiled_group_pixels(torch.zeros(33, 47, dtype=torch.bool), 8)
    assert len(found.order) == 0 and int(found.counts.sum()) == 0


def test_rays_are_cast_alike() -> None:
    v, u = torch.meshgrid(torch.arange(33), torch.arange(47), indexing="ij")
    uv = torch.stack([u.flatten(), v.flatten()], -1)  # the border too, where neighbours are missing
    found, plain = compiled_cast(view(), uv), plain_cast(view(), uv)
    for name in Rays.__dataclass_fields__:
        torch.testing.assert_close(getattr(found, name), getattr(plain, name), rtol=1e-4, atol=1e-5)
    assert float((found.cos_incidence < 0.99).float().mean()) > 0.05  # the slanted wall, beside holes and edges


@pytest.mark.parametrize(("near", "free"), [(6, 3), (1, 1)])
def test_samples_are_placed_alike(near: int, free: int) -> None:
    g = torch.Generator().manual_seed(1)
    rays = Rays(
        origins=torch.randn(50, 3, generator=g),
        directions=torch.randn(50, 3, generator=g),
        depth=4 * torch.rand(50, generator=g) + 0.1,
        colour=torch.rand(50, 3, generator=g),
        cos_incidence=torch.rand(50, generator=g),
    )
    jitter, free_jitter = torch.rand(50, near, generator=g), torch.rand(50, free, generator=g)
    found, plain = compiled_sample_points(rays, jitter, free_jitter, 0.1), plain_sample_points(rays, jitter, free_jitter, 0.1)
    torch.testing.assert_close(found[0], plain[0], rtol=1e-5, atol=1e-5)
    torch.testing.assert_close(found[1], plain[1], rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("noise", [0.01, 0.03])
def test_noise_does_not_move_the_surface(noise: float) -> None:
    # What the field learns of a point is the mean of its targets there; of a wall at 2 m, seen with noise, that is 0 at 2 m.
    g = torch.Generator().manual_seed(2)
    count, truncation = 200_000, 0.06
    along = torch.tensor([0.0, 0.0, 1.0]).expand(count, 3)
    depth = 2 + noise * torch.randn(count, generator=g)
    rays = Rays(torch.zeros(count, 3), along, depth, torch.zeros(count, 3), torch.ones(count))
    points, target = plain_sample_points(rays, torch.rand(count, 6, generator=g), torch.rand(count, 1, generator=g), truncation)
    z, target = points[: 6 * count, 2], target[: 6 * count]
    there = (z - 2).abs() < 0.002
    assert truncation * float(target[there].mean()) == pytest.approx(0, abs=0.01 * noise)
