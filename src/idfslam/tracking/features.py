"""The fully convolutional feature extractor (Sec. V, Fig. 4): a unit feature for every pixel, no stride, no pooling."""

import copy
from importlib.resources import as_file, files
from pathlib import Path
from typing import cast

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor, nn
from torch.nn import functional as F
from torch.nn.utils.fusion import fuse_conv_bn_eval

from idfslam.errors import ConfigError

WIDTH = 64  # channels of the trunk; more: a slower network, and the stored weights do not fit
CHANNELS = 32  # channels of a feature; more: slower matching, and the stored weights do not fit


class BasicBlock(nn.Module):
    """ResNet18's residual block of two 3x3 convolutions, stride 1."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(width, width, 3, padding=1, bias=False)
        self.bn1: nn.Module = nn.BatchNorm2d(width)
        self.conv2 = nn.Conv2d(width, width, 3, padding=1, bias=False)
        self.bn2: nn.Module = nn.BatchNorm2d(width)

    def forward(self, x: Tensor) -> Tensor:
        y = F.relu_(self.bn1(self.conv1(x)))  # in place: an image of 64 channels is too large for the nearest caches
        return F.relu_(self.bn2(self.conv2(y)).add_(x))


class FeatureExtractor(nn.Module):
    """Colour images (B, 3, H, W) in [0, 1] -> unit features (B, 32, H, W); Fig. 4 of the paper.

    `trunk` is all but the out-conv, and `head` is the out-conv: `head(trunk(images))` is `forward(images)`. The out-conv alone learns
    during a run.
    """

    def __init__(self) -> None:
        super().__init__()
        self.conv = nn.Conv2d(3, WIDTH, 3, padding=1, bias=False)
        self.bn: nn.Module = nn.BatchNorm2d(WIDTH)
        self.layer1 = nn.Sequential(BasicBlock(WIDTH), BasicBlock(WIDTH))
        self.layer2 = nn.Sequential(BasicBlock(WIDTH), BasicBlock(WIDTH))
        self.out_conv = nn.Sequential(nn.Conv2d(WIDTH, CHANNELS, 1, bias=False), nn.BatchNorm2d(CHANNELS))

    def trunk(self, images: Tensor) -> Tensor:
        """(B, 3, H, W) -> (B, 64, H, W)."""
        centred = 2 * images - 1
        return self.layer2(self.layer1(F.relu_(self.bn(self.conv(centred)))))

    def head(self, trunk: Tensor) -> Tensor:
        """(B, 64, H, W) -> unit features (B, 32, H, W)."""
        return F.normalize(self.out_conv(trunk), dim=1)

    def head_at(self, trunk: Tensor) -> Tensor:
        """`head` for some pixels alone, in eval mode: their (N, 64) -> unit features (N, 32)."""
        conv, norm = cast(nn.Conv2d, self.out_conv[0]), cast(nn.BatchNorm2d, self.out_conv[1])
        features = F.linear(trunk, conv.weight[:, :, 0, 0])
        return F.normalize(F.batch_norm(features, norm.running_mean, norm.running_var, norm.weight, norm.bias, eps=norm.eps), dim=1)

    def forward(self, images: Tensor) -> Tensor:
        return self.head(self.trunk(images))


def folded(extractor: FeatureExtractor, dtype: torch.dtype) -> FeatureExtractor:
    """A frozen copy in `dtype` whose trunk has its batch norms folded into the convolutions, channels last; for inference."""
    copied = copy.deepcopy(extractor).eval().requires_grad_(False)
    copied.conv, copied.bn = fuse_conv_bn_eval(copied.conv, cast(nn.BatchNorm2d, copied.bn)), nn.Identity()
    for block in (*copied.layer1, *copied.layer2):
        block.conv1, block.bn1 = fuse_conv_bn_eval(block.conv1, block.bn1), nn.Identity()
        block.conv2, block.bn2 = fuse_conv_bn_eval(block.conv2, block.bn2), nn.Identity()
    return copied.to(dtype).to(memory_format=torch.channels_last)  # type: ignore[call-overload, no-any-return]


def untrained_extractor(images: Tensor, seed: int = 0) -> FeatureExtractor:
    """Random filters whose batch norms are fitted to some images (B, 3, H, W): the baseline of the architecture without training."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        extractor = FeatureExtractor()
    for norm in extractor.modules():
        if isinstance(norm, nn.BatchNorm2d):
            norm.momentum = 1.0  # the batch norms take over the statistics of these images
    with torch.no_grad():
        extractor.train()(images)
    return extractor.eval()


def load_extractor(path: Path | None = None) -> FeatureExtractor:
    """The extractor with the weights in `path`, or with those shipped in the package (docs/model-card.md), in eval mode.

    Raises ConfigError for a file that is absent, is no safetensors file, or holds another network's weights.
    """
    if path is None:
        with as_file(files("idfslam.tracking") / "weights" / "extractor.safetensors") as shipped:
            return load_extractor(shipped)
    try:
        tensors = load_file(path)
    except (OSError, SafetensorError) as error:
        raise ConfigError(f"{path}: cannot be read as safetensors ({error}); expected weights written by `idf-slam pretrain`") from error
    extractor = FeatureExtractor()
    expected = {name: tuple(tensor.shape) for name, tensor in extractor.state_dict().items()}
    shapes = {name: tuple(tensor.shape) for name, tensor in tensors.items()}
    if shapes != expected:
        odd = sorted(name for name in expected.keys() | shapes.keys() if expected.get(name) != shapes.get(name))
        raise ConfigError(f"{path}: {len(odd)} tensors do not fit the extractor, first {odd[0]}; expected weights from `idf-slam pretrain`")
    extractor.load_state_dict(tensors)
    return extractor.eval()
