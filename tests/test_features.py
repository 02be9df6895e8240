"""The feature extractor: shape, unit length, receptive field, folding, and files that do not fit."""

from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file

from idfslam.errors import ConfigError
from idfslam.tracking.features import CHANNELS, FeatureExtractor, folded, load_extractor


@pytest.fixture
def extractor() -> FeatureExtractor:
    torch.manual_seed(0)
    network = FeatureExtractor().train()
    network(torch.rand(1, 3, 24, 32))  # batch norms away from their initial statistics
    return network.eval()


def test_every_pixel_gets_a_unit_feature(extractor: FeatureExtractor) -> None:
    features = extractor(torch.rand(2, 3, 13, 17))
    assert features.shape == (2, CHANNELS, 13, 17)
    torch.testing.assert_close(features.norm(dim=1), torch.ones(2, 13, 17))


def test_layers_of_figure_4(extractor: FeatureExtractor) -> None:
    # 3x3 convolutions: 1 into 64 channels, then 2 blocks x 2 BasicBlocks x 2; 1x1: 64 -> 32. Weights without biases:
    # 3*64*9 + 8*64*64*9 + 64*32 = 1728 + 294912 + 2048 = 298688; batch norms: 9 of 64 and 1 of 32 channels, scale and shift: 1216.
    assert sum(p.numel() for p in extractor.parameters()) == 298688 + 1216
    assert all(m.stride == (1, 1) for m in extractor.modules() if isinstance(m, torch.nn.Conv2d))


def test_receptive_field_is_nine_pixels_each_way(extractor: FeatureExtractor) -> None:
    image = torch.rand(1, 3, 31, 31)
    changed = image.clone()
    changed[..., 15, 15] += 0.5
    moved = (extractor(image) - extractor(changed)).abs().amax(1)[0] > 0
    rows, columns = moved.nonzero().T
    assert (rows - 15).abs().max() <= 9
    assert (columns - 15).abs().max() <= 9


def test_folding_keeps_the_trunk(extractor: FeatureExtractor) -> None:
    images = torch.rand(1, 3, 12, 16)
    with torch.no_grad():
        torch.testing.assert_close(folded(extractor, torch.float32).trunk(images), extractor.trunk(images), atol=1e-4, rtol=1e-4)


def test_folding_leaves_the_original_alone(extractor: FeatureExtractor) -> None:
    before = {name: tensor.clone() for name, tensor in extractor.state_dict().items()}
    folded(extractor, torch.bfloat16)
    assert all(torch.equal(tensor, before[name]) for name, tensor in extractor.state_dict().items())


def test_shipped_weights_load() -> None:
    assert not load_extractor().training


def test_missing_weights(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be read as safetensors"):
        load_extractor(tmp_path / "absent.safetensors")


def test_damaged_weights(tmp_path: Path) -> None:
    (tmp_path / "bad.safetensors").write_bytes(b"not tensors at all")
    with pytest.raises(ConfigError, match="cannot be read as safetensors"):
        load_extractor(tmp_path / "bad.safetensors")


def test_weights_of_another_network(tmp_path: Path) -> None:
    save_file({"layer.weight": torch.zeros(3)}, tmp_path / "other.safetensors")
    with pytest.raises(ConfigError, match="do not fit the extractor"):
        load_extractor(tmp_path / "other.safetensors")


def test_features_of_some_pixels(extractor: FeatureExtractor) -> None:
    trunk = extractor.trunk(torch.rand(1, 3, 12, 16))
    pixels = torch.tensor([0, 5, 100, 191])
    torch.testing.assert_close(extractor.head_at(trunk[0].flatten(1).mT[pixels]), extractor.head(trunk)[0].flatten(1).mT[pixels])
