import math
import time

import pytest
import torch

from idfslam.geometry import se3
from idfslam.geometry.camera import Camera
from idfslam.graph.covisibility import compiled_in_view, covisibility, plain_in_view, sampled_points

CAMERA = Camera(640, 480, 500.0, 500.0, 319.5, 239.5)


def shifted(x: float = 0.0, y: float = 0.0, z: float = 0.0, turn: float = 0.0) -> torch.Tensor:
    """T_kn of a translation [m] and a rotation [rad] about y."""
    T = se3.exp(torch.tensor([0, 0, 0, 0, turn, 0]))
    T[:3, 3] = torch.tensor([x, y, z])
    return T


def test_wall_by_hand() -> None:
    # A wall at 2 m: 1 m sideways moves its pixels by 500 * 1 / 2 = 250 of 640 columns, so 390 / 640 stay; 0.96 m upwards by 240 of 480
    # rows: half stays. Facing away (half a turn): none. The same place: all.
    T_kn = torch.stack([shifted(), shifted(x=1.0), shifted(x=-1.0), shifted(y=0.96), shifted(turn=math.pi), shifted(x=10.0)])
    shares = covisibility(torch.full((480, 640), 2.0), CAMERA, T_kn, [CAMERA] * len(T_kn), subsample=1)
    torch.testing.assert_close(shares, torch.tensor([1, 390 / 640, 390 / 640, 0.5, 0, 0]), atol=1e-3, rtol=0)


def test_subsampling_changes_little() -> None:
    depth = torch.full((480, 640), 2.0)
    T_kn = torch.stack([shifted(x=0.4, turn=0.2), shifted(y=0.3, z=0.5)])
    fine, coarse = (covisibility(depth, CAMERA, T_kn, [CAMERA] * len(T_kn), subsample=s) for s in (1, 8))
    torch.testing.assert_close(fine, coarse, atol=0.02, rtol=0)


def test_only_pixels_with_depth_count() -> None:
    # The right half has no reading; a move of 250 px to the right keeps the whole left half (320 + 250 < 640) ...
    depth = torch.full((480, 640), 2.0)
    depth[:, 320:] = 0
    assert float(covisibility(depth, CAMERA, shifted(x=1.0)[None], [CAMERA])[0]) == 1
    # ... and to the left 70 of its 320 columns.
    assert float(covisibility(depth, CAMERA, shifted(x=-1.0)[None], [CAMERA], subsample=1)[0]) == pytest.approx(70 / 320, abs=1e-3)


def test_no_depth_sees_nothing() -> None:
    assert covisibility(torch.zeros(480, 640), CAMERA, shifted().expand(3, 4, 4), [CAMERA] * 3).tolist() == [0, 0, 0]


def test_occlusion() -> None:
    # The new keyframe sees a wall at 4 m; the stored one, at the same place, saw a board at 1 m before its left half and has no reading
    # in the right half's upper half.
    depth = torch.full((480, 640), 4.0)
    stored = torch.full((480, 640), 4.0)
    stored[:, :320] = 1.0
    stored[:240, 320:] = 0
    assert float(covisibility(depth, CAMERA, shifted()[None], [CAMERA])[0]) == 1
    assert float(covisibility(depth, CAMERA, shifted()[None], [CAMERA], [stored])[0]) == 0.5


def test_compiled_equals_plain() -> None:
    """Tilted wall, forty cameras all around it, another camera's image: the same points in view, but for one on an edge now and then."""
    depth = torch.linspace(1, 5, 640).expand(480, 640).contiguous()
    points = sampled_points(depth, CAMERA, 8)
    T_kn = se3.exp(torch.randn(40, 6, generator=torch.Generator().manual_seed(2)))
    narrow = Camera(320, 200, 300.0, 310.0, 150.0, 120.0)
    plain = plain_in_view(points, T_kn, narrow).sum(1)
    assert int((plain > 0).sum()) > 10
    assert int((plain - compiled_in_view(points, T_kn, narrow)).abs().max()) <= 1


def test_other_camera() -> None:
    # Half the field of view in each direction: a quarter of the pixels.
    narrow = Camera(320, 240, 500.0, 500.0, 159.5, 119.5)
    shares = covisibility(torch.full((480, 640), 2.0), CAMERA, shifted()[None], [narrow], subsample=1)
    assert float(shares[0]) == pytest.approx(0.25, abs=1e-3)


def test_keyframes_of_two_cameras() -> None:
    # A wall at 2 m in full view, its columns counted from the middle: -320 to 320, rows -240 to 240. Moved by 1 m they lie 250 columns
    # farther right. The own camera has all in view, and 390 of 640 columns. The narrow camera (the same focal length) has columns -160 to
    # 160 and half of the rows, a quarter in all; moved, columns -320 to -90: 230 of 640, and half of the rows. The wide camera's focal
    # length is a fifth: the wall is 128 of its 160 columns wide, all in view; moved by 50 of them, -14 to 114 of which 80 and less: 94.
    narrow, wide = Camera(320, 240, 500.0, 500.0, 159.5, 119.5), Camera(160, 120, 100.0, 100.0, 79.5, 59.5)
    depth = torch.full((480, 640), 2.0)
    T_kn = torch.stack([shifted(), shifted(), shifted(x=1.0), shifted(x=1.0), shifted(), shifted(x=1.0)])
    cameras = [CAMERA, narrow, CAMERA, narrow, wide, wide]
    expected = torch.tensor([1, 0.25, 390 / 640, 230 / 640 / 2, 1, 94 / 128])
    torch.testing.assert_close(covisibility(depth, CAMERA, T_kn, cameras, subsample=1), expected, atol=2e-3, rtol=0)
    # With what each measured: the narrow one saw a board at 1 m everywhere, the wide one nothing, so its bounds decide.
    boards = {CAMERA: torch.full((480, 640), 2.0), narrow: torch.full((240, 320), 1.0), wide: torch.zeros(120, 160)}
    shares = covisibility(depth, CAMERA, T_kn, cameras, [boards[camera] for camera in cameras], subsample=1)
    torch.testing.assert_close(shares, torch.tensor([1, 0, 390 / 640, 0, 1, 94 / 128]), atol=2e-3, rtol=0)


def test_a_hundred_keyframes_at_once_equal_one_by_one() -> None:
    depth = 1 + torch.rand(240, 320, generator=torch.Generator().manual_seed(0))
    camera = CAMERA.resized(320, 240)
    T_kn = se3.exp(torch.randn(100, 6, generator=torch.Generator().manual_seed(1)) * 0.3)
    together = covisibility(depth, camera, T_kn, [camera] * 100)
    torch.testing.assert_close(together, torch.cat([covisibility(depth, camera, T[None], [camera]) for T in T_kn]))
    start = time.perf_counter()
    covisibility(depth, camera, T_kn, [camera] * 100)
    assert time.perf_counter() - start < 0.5  # about 2 ms on an idle core
