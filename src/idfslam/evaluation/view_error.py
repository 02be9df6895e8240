"""How well rendered views agree with recorded images: PSNR and SSIM over all pixels."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from skimage.metrics import structural_similarity

from idfslam.sensing.matched_exposure import matched_exposure

Image = NDArray[np.float32]

_LEAST = 1e-10  # [1] least mean squared error. Less: equal images count as more than 100 dB. Chosen by hand
_WINDOW: dict[str, Any] = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False}  # as in the paper: a fact
SCHEMA = 1  # of views.json; counts up when a reader of the older form would misread the file


@dataclass(frozen=True)
class ViewError:
    """The error of one view."""

    index: int  # of the frame
    psnr: float  # [dB]
    ssim: float  # [1]
    psnr_matched: float  # [dB] with the gain and the offset of each channel that fit the recorded image best
    holes: float  # [1] share of pixels without a depth; they count like all others
    seconds: float  # that rendering took


def view_error(index: int, rendered: Image, recorded: Image, lit: NDArray[np.bool_], holes: float, seconds: float) -> ViewError:
    """The error of a rendered view (H, W, 3) against a recorded image (H, W, 3), both in [0, 1].

    lit (H, W): the pixels that the camera fills. All of these count.
    """
    matched = matched_exposure(rendered, recorded, lit)
    return ViewError(
        index, psnr(rendered[lit], recorded[lit]), ssim(rendered, recorded, lit), psnr(matched[lit], recorded[lit]), holes, seconds
    )


def psnr(a: Image, b: Image) -> float:
    """Peak signal-to-noise ratio [dB] of two images in [0, 1]."""
    return -10 * float(np.log10(max(float(((a - b).astype(np.float64) ** 2).mean()), _LEAST)))


def ssim(a: Image, b: Image, lit: NDArray[np.bool_] | None = None) -> float:
    """Structural similarity [1] of two images (H, W, 3) in [0, 1] (Wang et al. 2004, a Gaussian window of 1.5 px), mean of the channels.

    lit (H, W): the pixels that count, which are black elsewhere; None: all.
    """
    if lit is not None and not lit.all():
        a, b = a * lit[..., None], b * lit[..., None]
        local = structural_similarity(a, b, channel_axis=-1, data_range=1.0, full=True, **_WINDOW)[1]
        return float(local[lit].mean())
    return float(structural_similarity(a, b, channel_axis=-1, data_range=1.0, **_WINDOW))


def summary(errors: Sequence[ViewError]) -> dict[str, Any]:
    """The content of views.json: means over the views, and the views themselves."""
    names = ("psnr", "ssim", "psnr_matched", "holes", "seconds")
    means = {name: float(np.mean([getattr(error, name) for error in errors])) for name in names}
    return {"schema": SCHEMA, "count": len(errors), **means, "views": [asdict(error) for error in errors]}
