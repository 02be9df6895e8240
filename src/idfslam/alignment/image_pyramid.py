"""Pyramids of an image's brightness: used from the coarsest level on, they widen the range of an alignment."""

from dataclasses import dataclass

import cv2
import torch
import torch.nn.functional as F
from torch import Tensor

from idfslam.compute.backend import pick
from idfslam.geometry.camera import Camera
from idfslam.sensing.vignette import Vignette


@dataclass(frozen=True)
class Level:
    """One level of an image pyramid."""

    luminance: Tensor  # (h, w) in [0, 1]
    camera: Camera

    def at(self, uv: Tensor) -> Tensor:
        """Luminance and its derivatives along u and v [1/px] at pixels (N, 2), bilinear: (3, N). Outside, those of the nearest border."""
        return pick(self.luminance, compiled=compiled_sampled, plain=plain_sampled)(self.luminance, uv)

    def shares(self, uv: Tensor) -> Tensor:
        """Pixels (N, 2) as shares of the image's width and height: (N, 2), from 0 at its left and upper edge to 1."""
        return (uv + 0.5) / uv.new_tensor([self.camera.width, self.camera.height])

    def luminance_at(self, uv: Tensor) -> Tensor:
        """Luminance (N,) at pixels (N, 2), as `at` gives it."""
        return self.at(uv)[0]


def pyramid(colour: Tensor, camera: Camera, *, height: int, levels: int, vignette: Vignette | None = None) -> list[Level]:
    """The luminance pyramid of an image (H, W, 3), finest level first. That has at least `height` rows, each next one half as many.

    vignette: is taken out of the image.
    """
    full = luminance(colour)
    if vignette is not None:
        full = full / vignette.image(camera).to(full)
    shrink = max(1, camera.height // height)
    out: list[Level] = []
    for _ in range(levels):
        finer = out[-1].luminance if out else full
        halved = bool(out) and finer.shape[0] % 2 == 0 and finer.shape[1] % 2 == 0  # a mean of equally many pixels' means is their mean
        image = half(finer) if halved else F.avg_pool2d(full[None], shrink)[0] if shrink > 1 else full
        out.append(Level(image, camera.resized(image.shape[1], image.shape[0])))
        shrink *= 2
    return out


def half(image: Tensor) -> Tensor:
    """(h, w), both even, -> (h / 2, w / 2): the means of 2 x 2 pixels."""
    return pick(image, compiled=opencv_half, plain=plain_half)(image)


def plain_half(image: Tensor) -> Tensor:
    """`half` in torch, on any device."""
    return F.avg_pool2d(image[None], 2)[0]


def opencv_half(image: Tensor) -> Tensor:
    """`half` by OpenCV, on the CPU."""
    return torch.from_numpy(cv2.resize(image.numpy(), None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA))


def luminance(colour: Tensor) -> Tensor:
    """(H, W, 3) -> (H, W): the mean of the three channels."""
    return pick(colour, compiled=compiled_luminance, plain=plain_luminance)(colour)


def plain_luminance(colour: Tensor) -> Tensor:
    """`luminance` in torch, on any device."""
    return colour.mean(-1)


def compiled_luminance(colour: Tensor) -> Tensor:
    """`luminance` by Numba, on the CPU."""
    from idfslam.alignment.kernels import numba_images

    out = torch.empty(colour.shape[:2])
    numba_images.luminance_of(colour.contiguous().numpy(), out.numpy())  # type: ignore[call-arg]
    return out


def plain_sampled(image: Tensor, uv: Tensor) -> Tensor:
    """An image (h, w) and its slopes at pixels (N, 2), (3, N), in torch, on any device."""
    place = ((uv + 0.5) * (2 / uv.new_tensor([image.shape[1], image.shape[0]])) - 1)[None, None]
    return F.grid_sample(with_slopes(image)[None], place, align_corners=False, padding_mode="border")[0, :, 0]


def compiled_sampled(image: Tensor, uv: Tensor) -> Tensor:
    """`plain_sampled` by Numba, on the CPU."""
    from idfslam.alignment.kernels import numba_images

    out = torch.empty(3, len(uv))
    numba_images.sampled(image.numpy(), uv.contiguous().numpy(), out.numpy())  # type: ignore[call-arg]
    return out


def with_slopes(image: Tensor) -> Tensor:
    """(h, w) -> (3, h, w): the image and its central differences along u and v; zero at the border."""
    out = image.new_zeros(3, *image.shape)
    out[0] = image
    out[1, :, 1:-1] = (image[:, 2:] - image[:, :-2]) / 2
    out[2, 1:-1] = (image[2:] - image[:-2]) / 2
    return out
