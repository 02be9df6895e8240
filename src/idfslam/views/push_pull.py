"""Smooth values where an image has none (Gortler 1996, pull-push): means of ever larger neighbourhoods, from the known pixels."""

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]


def push_pull(image: Floats, known: NDArray[np.bool_]) -> Floats:
    """The image (H, W) or (H, W, C), with values where it is not `known` (H, W). Known pixels stay; all is 0 where none is known."""
    if known.all():
        return image
    pyramid = [np.concatenate([np.atleast_3d(image) * known[..., None], known[..., None]], -1).astype(np.float32)]  # weighted, and weight
    while min(pyramid[-1].shape[:2]) > 1:
        height, width = pyramid[-1].shape[:2]
        half = cv2.resize(pyramid[-1], (-(-width // 2), -(-height // 2)), interpolation=cv2.INTER_AREA)
        pyramid.append(np.asarray(half, np.float32).reshape(*half.shape[:2], -1))
    top = pyramid.pop()
    filled = top[..., :-1] / np.maximum(top[..., -1:], 1e-6)
    for level in pyramid[::-1]:
        above = cv2.resize(filled, level.shape[1::-1], interpolation=cv2.INTER_LINEAR).reshape(*level.shape[:2], -1)
        filled = level[..., :-1] + (1 - level[..., -1:]) * above
    return np.where(known.reshape(known.shape + (1,) * (image.ndim - 2)), image, filled.reshape(image.shape)).astype(np.float32)
