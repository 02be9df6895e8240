"""After a loop the map is to follow around the camera before the next frame: it has the surfaces there twice until then."""

from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from idfslam.config import KeyframeConfig, LoopConfig
from idfslam.frame import Frame
from idfslam.geometry.camera import Camera
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.slam.place_recognition.loop_closer import LoopCloser

CAMERA = Camera(64, 48, 40.0, 40.0, 31.5, 23.5)


def at(x: float, y: float) -> Tensor:
    T = torch.eye(4, dtype=torch.float64)
    T[0, 3], T[1, 3] = x, y
    return T


def keyframe(index: int, T_wk: Tensor) -> Keyframe:
    frame = Frame(index, index / 30, np.zeros((48, 64, 3), np.float32), np.full((48, 64), 0.05, np.float32), CAMERA)
    return Keyframe(frame, T_wk, torch.from_numpy(frame.depth), torch.from_numpy(frame.colour))


class Finds:
    """A relocaliser that finds each view 0.1 m beside where it is thought to be."""

    def images_agree(self, view: Keyframe, other: Keyframe, T_wc: Tensor) -> bool:
        return False

    def retrieve(self, view: Keyframe, keyframes: list[Keyframe], count: int) -> list[int]:
        distances = [float((k.T_wk - view.T_wk)[:3, 3].norm()) for k in keyframes]
        return [int(i) for i in np.argsort(distances)[:count]]

    def verify_loop(self, view: Keyframe, other: Keyframe) -> Tensor:
        return at(0.0, -0.1) @ view.T_wk


@pytest.fixture
def graph() -> KeyframeGraph:
    """Round a square of 5 m."""
    made = KeyframeGraph(KeyframeConfig(), verify=True)
    for i in range(41):
        side, way = divmod(0.5 * i, 5)
        places = [(way, 0.0), (5.0, way), (5 - way, 5.0), (0.0, 5 - way), (0.0, 0.1)]
        made.insert(keyframe(i, at(*places[int(side)])))
    return made


def test_the_map_follows_a_loop_at_once(graph: KeyframeGraph) -> None:
    finds: Any = Finds()
    closer = LoopCloser(LoopConfig(), finds, graph)
    first = closer.on_keyframe(graph.keyframes[-1])
    assert not first.keyframes
    assert not first.at_once  # one loop is not believed
    graph.insert(keyframe(41, at(0.3, 0.1)))
    moved = closer.on_keyframe(graph.keyframes[-1])
    assert len(closer.closed_loops()) == 2
    assert moved.at_once
    assert graph.keyframes[-1] in moved.keyframes
    assert float(graph.keyframes[-1].T_wk[1, 3]) == pytest.approx(0, abs=0.02)
