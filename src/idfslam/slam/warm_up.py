"""Warm-up: SLAM compiles and loads code at its first frames. This is done before a live camera's first frame, which would be delayed."""

from collections.abc import Callable

import numpy as np

from idfslam.compute.backend import Backend, backend_of
from idfslam.compute.cache_folder import kernels_on_disk
from idfslam.compute.devices import resolve_device
from idfslam.config import Config
from idfslam.frame import Frame
from idfslam.geometry.camera import Camera
from idfslam.geometry.sensor_timing import SYNCHRONISED, SensorTiming
from idfslam.slam import Slam

COMPILING = "compiling kernels, once: about a minute"

_CAMERA = Camera(160, 120, 140.0, 140.0, 79.5, 59.5)
_BOX = np.array([1.5, 1.1, 1.8])  # [m] half the sides of the made-up room
_SQUARE = 0.17  # [m] squares of its walls; smaller: they are lost in small images
_FRAMES = 12  # made-up frames, of which three are keyframes; more: nothing new is compiled
_ROLLING = 6  # the first frame of a rolling shutter, so that both kinds of alignment are compiled; more: fewer frames are of it
_BESIDE = 4  # the first frame with something that moves; more: the room is seen for longer without it


def will_compile(config: Config) -> bool:
    """Whether the first frames of a run wait for kernels of the feature grid to be compiled, because they are not on disk yet."""
    device = resolve_device(config.device, config.preset)
    return config.field.encoding == "grid" and backend_of(device) is Backend.NUMBA and not kernels_on_disk()


def warm_up(config: Config, make_slam: Callable[[Config], Slam] = Slam) -> Slam:
    """Runs a Slam on the made-up frames: it maps, aligns, masks, and with a doubtful frame uses the tracker. The result is discarded."""
    slam = make_slam(config)
    for frame in made_up_frames():
        slam.process(frame)
    return slam


def made_up_frames() -> list[Frame]:
    """A camera moves in a box with random squares, and something passes before it. The last frame is of another box, so it is doubtful."""
    return [made_up(i) for i in range(_FRAMES)]


def made_up(i: int) -> Frame:
    """Frame i of them. Each ray leaves the box at the wall that it meets first."""
    other = i == _FRAMES - 1
    half = _BOX * (1.3 if other else 1.0)
    turn = np.deg2rad(30.0 + 2.0 * i)
    R_wc = np.array([[np.cos(turn), 0.0, np.sin(turn)], [0.0, 1.0, 0.0], [-np.sin(turn), 0.0, np.cos(turn)]])
    centre = np.array([0.04 * i - 0.3, 0.02 * np.sin(i), 0.0])
    rays = _CAMERA.rays(_CAMERA.pixels().double()).numpy() @ R_wc.T
    to_walls = (np.sign(rays) * half - centre) / rays
    depth, wall = to_walls.min(-1), to_walls.argmin(-1)
    cell = np.floor((centre + rays * depth[..., None]) / _SQUARE).astype(int) % 32
    colour = np.random.default_rng(other).random((3, 32, 32, 32, 3), np.float32)[wall, cell[..., 0], cell[..., 1], cell[..., 2]]
    if i >= _BESIDE and not other:
        columns = slice(9 * i, 9 * i + 30)
        depth[40:100, columns], colour[40:100, columns] = 0.9, 0.5
    timing = SensorTiming(0.02, 0.02) if i >= _ROLLING else SYNCHRONISED
    return Frame(i, i / 30, np.ascontiguousarray(colour), depth.astype(np.float32), _CAMERA, timing=timing)
