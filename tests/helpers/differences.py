"""Where two objects of the package hold other values, however deep: what a component forgets to keep is found by it."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import torch
from torch import nn

from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.storage.frame_memory import FrameMemory
from idfslam.storage.state import Stateful

# from keyframes' images, or from what is kept
WORKED_OUT_AGAIN = {
    *("_images", "_images_at", "_features", "_features_at", "_swap", "swap"),  # of a keyframe
    *("farthest", "depth_share", "readings", "_shown"),  # likewise
    *("_appearances", "_landmarks"),  # of the aligner
    "_pixels",  # of the mapper
    "_thumbnails",  # of the estimation of light
    "_solved",  # of the estimator of the sensor's times, from its sums
    "around",  # of a remembered view, from what moves in it
}
OF_A_PROCESS = {"_pool", "_running", "_early", "_final", "_milliseconds"}  # threads and times


def differences(a: Any, b: Any, where: str, compared: set[tuple[int, int]] | None = None) -> Iterator[str]:
    """The places, each with what was found there; functions are not looked into.

    compared: parts that were compared already: each is compared where it is first met.
    """
    compared = set() if compared is None else compared
    if type(a) is not type(b):
        yield f"{where}: {type(a).__name__} and {type(b).__name__}"
        return
    if isinstance(a, Stateful | KeyframeGraph):
        if (id(a), id(b)) in compared:
            return
        compared.add((id(a), id(b)))
    mine, other = parts(a), parts(b)
    if mine is None or other is None:
        if not equal(a, b):
            yield f"{where}: {a} and {b}"
        return
    for key in [*mine, *(key for key in other if key not in mine)]:
        if key in mine and key in other:
            yield from differences(mine[key], other[key], f"{where}.{key}", compared)
        else:
            yield f"{where}.{key}: in one alone"


def parts(value: Any) -> dict[Any, Any] | None:
    """What an object is made of; None for one that is compared as a whole."""
    if isinstance(value, dict):
        return value
    if isinstance(value, list | tuple):
        return dict(enumerate(value))
    if isinstance(value, FrameMemory):
        return value.state()
    if isinstance(value, torch.Generator):
        return {"state": value.get_state()}
    if isinstance(value, torch.optim.Optimizer):
        return value.state_dict()
    if isinstance(value, nn.Module):
        return attributes(value) | value._parameters | value._buffers | value._modules
    return attributes(value) if type(value).__module__.startswith("idfslam.") and hasattr(value, "__dict__") else None


def attributes(value: Any) -> dict[str, Any]:
    private = isinstance(value, nn.Module)  # torch's own
    return {
        name: v for name, v in vars(value).items() if name not in WORKED_OUT_AGAIN | OF_A_PROCESS and not (private and name.startswith("_"))
    }


def equal(a: Any, b: Any) -> bool:
    if isinstance(a, torch.Tensor):
        return a.dtype == b.dtype and a.requires_grad == b.requires_grad and torch.equal(a, b)
    return np.array_equal(a, b) if isinstance(a, np.ndarray) else bool(callable(a) or a == b)
