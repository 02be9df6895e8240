"""Warm-up: SLAM compiles and loads code at its first frames. This is done before a live camera's first frame, which would be delayed."""

from collections.abc import Callable

import numpy as np

from idfslam.compute.backend import Backend, backend_of
from idfslam.compute.cache_folder import kernels_on_disk
from idfslam.compute.devices import resolve_device
from idfslam.config import Config
from idfslam.frame import Frame
from idfslam.geometry.camera import Camera
from idfslam.slam import Slam

_CAMERA = Camera(160, 120, 140.0, 140.0, 79.5, 59.5)
COMPILING = "compiling kernels, once: about a minute"
_FRAMES = 4  # made-up frames; more: nothing new is compiled


def will_compile(config: Config) -> bool:
    """Whether the first frames of a run wait for kernels of the feature grid to be compiled, because they are not on disk yet."""
    device = resolve_device(config.device, config.preset)
    return config.field.encoding == "grid" and backend_of(device) is Backend.NUMBA and not kernels_on_disk()


def warm_up(config: Config, make_slam: Callable[[Config], Slam] = Slam) -> Slam:
    """Runs a Slam on a few synthetic frames: it maps, aligns, and with a doubtful frame uses the tracker. The result is discarded."""
    slam = make_slam(config)
    for i in range(_FRAMES):
        slam.process(made_up(i))
    return slam


def made_up(i: int) -> Frame:
    """Frame i: the corner of a room with random squares. The last frame has other squares and another shape, so it is doubtful."""
    rng = np.random.default_rng(i == _FRAMES - 1)
    squares = rng.random((_CAMERA.height // 8, _CAMERA.width // 8, 3), np.float32)
    colour = squares.repeat(8, 0).repeat(8, 1)
    v, u = np.mgrid[-1:1:120j, -1:1:160j].astype(np.float32)
    slopes = rng.uniform(0.5, 1.0, 3)
    depth = np.float32(2.5) - np.maximum(np.maximum(u * slopes[0], -u * slopes[1]), v * slopes[2]).astype(np.float32)
    return Frame(i, i / 30, colour, depth, _CAMERA)
