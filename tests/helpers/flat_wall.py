"""Keyframes in a row before a flat wall, so that the share of a view that stays in view can be worked out by hand."""

import math

import numpy as np
import torch
from torch import Tensor

from idfslam.config import KeyframeConfig
from idfslam.frame import Frame, Status
from idfslam.geometry import se3
from idfslam.geometry.camera import Camera
from idfslam.graph.frame_poses import FramePoses
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph

# A wall at 2 m with f = 40 px: x metres sideways move its pixels by 20 x of 64 columns, so that 1 - 20 x / 64 of them stay in view.
CAMERA = Camera(64, 48, 40.0, 40.0, 31.5, 23.5)
PAPER = KeyframeConfig(translation=0.15, rotation=12.0, cull=0.5, cull_reach=0, covisible=0.3, replay=10, replay_connected=0)


def at(x: float, turn: float = 0.0) -> Tensor:
    """T_wc of a shift along the wall [m] and a turn about y [degrees]."""
    T = se3.exp(torch.tensor([0, 0, 0, 0, math.radians(turn), 0], dtype=torch.float64))
    T[0, 3] = x
    return T


def keyframe(index: int, x: float) -> Keyframe:
    frame = Frame(index, index / 30, np.zeros((48, 64, 3), np.float32), np.full((48, 64), 2, np.float32), CAMERA)
    return Keyframe(frame, at(x), torch.from_numpy(frame.depth), torch.from_numpy(frame.colour))


def insert(frames: FramePoses, new: Keyframe) -> bool:
    """Appends a frame that becomes a keyframe; whether it is stored."""
    frames.append(new.timestamp, new.T_wk, Status.OK)
    stored = frames.graph.insert(new)
    frames.attach_last(new)
    return stored


def wall_frames(config: KeyframeConfig = PAPER, *, places: tuple[float, ...] = (), verify: bool = False) -> FramePoses:
    """Frames at x = places [m], each a keyframe of a graph."""
    frames = FramePoses(KeyframeGraph(config, verify=verify))
    for i, x in enumerate(places):
        insert(frames, keyframe(i, x))
    return frames


def wall_graph(config: KeyframeConfig = PAPER, *, places: tuple[float, ...] = ()) -> KeyframeGraph:
    """The graph of such frames."""
    return wall_frames(config, places=places).graph
