"""Where a pose puts patches in another image: compiled as plain, for patches in view and out of it."""

import numpy as np
import pytest
import torch

from idfslam.adjustment.camera_model import NAMES, CameraModel
from idfslam.adjustment.patch_search import compiled_predict, inverses, plain_predict
from idfslam.geometry import se3
from idfslam.geometry.camera import Camera
from idfslam.tracking.patches import Patches

CAMERA = Camera(64, 48, 60.0, 61.0, 31.0, 24.5)


def patches(count: int) -> Patches:
    """Patches all over the image, 0.05 to 4 m away, of surfaces that face the camera more or less."""
    random = torch.Generator().manual_seed(0)
    uv = torch.rand(count, 2, generator=random, dtype=torch.float64) * torch.tensor([64.0, 48.0]) - 0.5
    rays = CAMERA.rays(uv)
    points = rays * (0.05 + 4 * torch.rand(count, 1, generator=random, dtype=torch.float64))
    normals = torch.nn.functional.normalize(-rays + torch.randn(count, 3, generator=random, dtype=torch.float64), dim=1)
    return Patches(uv, points, normals)


@pytest.mark.parametrize("distortion", [0.0, -0.08])
def test_compiled_predictions_are_the_plain_ones(distortion: float) -> None:
    values = np.where(np.array(NAMES) == "k1", distortion, 0.0)
    model, T_oh = CameraModel(CAMERA, values), se3.exp(torch.tensor([0.3, -0.1, -0.6, 0.1, 0.4, -0.2], dtype=torch.float64)).numpy()
    compiled, plain = (form(patches(400), T_oh, model) for form in (compiled_predict, plain_predict))
    assert 50 < len(plain.patch) < 350
    assert compiled.patch.tolist() == plain.patch.tolist()
    np.testing.assert_allclose(compiled.z, plain.z, rtol=1e-12)
    for mine, other in ((compiled.start, plain.start), (compiled.warp, plain.warp)):
        torch.testing.assert_close(mine, other, rtol=1e-5, atol=1e-5)


def test_at_the_same_place_patches_stay() -> None:
    found = compiled_predict(patches(50), np.eye(4), CameraModel.as_stated(CAMERA))
    torch.testing.assert_close(found.start, patches(50).uv[torch.from_numpy(found.patch)].float())
    torch.testing.assert_close(found.warp, torch.eye(2).expand(len(found.patch), 2, 2), rtol=1e-5, atol=1e-5)


def test_inverses_are_those_of_torch() -> None:
    A = torch.randn(20, 2, 2, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    H = A @ A.mT + 0.1 * torch.eye(2)
    np.testing.assert_allclose(inverses(H.numpy()), torch.linalg.inv(H).numpy(), rtol=1e-9)
