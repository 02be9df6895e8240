"""Where a lost camera is looked for: around the place where it was lost first, then everywhere."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from idfslam.config import KeyframeConfig, LoopConfig
from idfslam.frame import Frame, Status
from idfslam.geometry.camera import Camera
from idfslam.graph.frame_poses import FramePoses
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.slam.place_recognition.recovery import Relocalisation
from idfslam.slam.stage_timer import StageTimer
from idfslam.slam.tracked import Evidence, Source, Tracked

CAMERA = Camera(64, 48, 40.0, 40.0, 31.5, 23.5)


def view_at(x: float, index: int, rows: int = 48) -> Keyframe:
    """A view of a wall at 5 cm, which shares nothing with one half a metre away. rows: of 48, from the lowest on, that have depth."""
    T = torch.eye(4, dtype=torch.float64)
    T[0, 3] = x
    depth = np.full((48, 64), 0.05, np.float32) * (np.arange(48) >= 48 - rows)[:, None].astype(np.float32)
    frame = Frame(index, index / 30, np.zeros((48, 64, 3), np.float32), depth, CAMERA)
    return Keyframe(frame, T, torch.from_numpy(frame.depth), torch.from_numpy(frame.colour))


@dataclass
class Asked:
    """A relocaliser that finds nothing, and the positions of the keyframes that it was asked for [m]."""

    places: list[list[float]] = field(default_factory=list)
    aligner: Any = field(default_factory=lambda: SimpleNamespace(usual_error=SimpleNamespace(is_known=True)))

    def relocalise(self, view: Keyframe, keyframes: Sequence[Keyframe], tries: int) -> None:
        self.places.append([float(k.T_wk[0, 3]) for k in keyframes])


@pytest.fixture
def asked() -> Asked:
    return Asked()


@pytest.fixture
def recovery(asked: Asked) -> Relocalisation:
    """Keyframes at 0, 1 ... 5 m; the camera was lost at the last of them."""
    graph = KeyframeGraph(KeyframeConfig(), verify=True)
    frames = FramePoses(graph)
    for i in range(6):
        view = view_at(float(i), i)
        frames.append(i / 30, view.T_wk, Status.OK)
        graph.insert(view)
        frames.attach_last(view)
    check: Any = SimpleNamespace(begin=lambda: None)
    return Relocalisation(LoopConfig(submap_after=0), asked, check, graph, frames, StageTimer())  # type: ignore[arg-type]


def lose(recovery: Relocalisation, index: int) -> None:
    view = view_at(5.0, index)
    tracked = recovery.recover(view, Tracked(view.T_wk, Status.LOST, Source.PREDICTED))
    recovery.frames.append(index / 30, tracked.T_wc, tracked.status)


def test_it_is_looked_for_nearby_first(recovery: Relocalisation, asked: Asked) -> None:
    lose(recovery, 6)
    assert asked.places == [[4.0, 5.0], [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]]


def test_after_a_while_it_may_be_anywhere(recovery: Relocalisation, asked: Asked) -> None:
    for i in range(6, 22):
        lose(recovery, i)
    assert asked.places[-2:] == [[], [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]]


def test_a_camera_in_doubt_for_long_is_elsewhere(recovery: Relocalisation, asked: Asked) -> None:
    view = view_at(5.0, 6)
    for _ in range(15):
        assert not recovery.recover(view, Tracked(view.T_wk, Status.DOUBTFUL, Source.ALIGNED)).is_lost
    assert asked.places == [[], [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]]


def test_a_camera_in_doubt_where_no_keyframe_tells_begins_a_submap(recovery: Relocalisation) -> None:
    """The fifteenth doubtful frame is the first of the thirty. One that sees the keyframes may be confirmed yet, and goes on."""
    recovery.config = LoopConfig(submap_after=30)
    view = view_at(5.0, 6)
    for in_view, began in ((0.5, None), (0.1, 44)):
        doubtful = Tracked(view.T_wk, Status.DOUBTFUL, Source.ALIGNED, Evidence(in_view=in_view), clear=False)
        recovery._doubted = recovery._searched = 0
        found = [recovery.recover(view, doubtful) for _ in range(44)]
        assert next((i + 1 for i, tracked in enumerate(found) if tracked.source is Source.NEW_SUBMAP), None) == began
    assert found[-1].status is Status.OK and found[-1].clear and recovery.graph.starts_submap


@pytest.mark.parametrize(
    ("mapped", "rows", "doubted", "begins"), [(4, 48, 0, True), (4, 4, 0, False), (48, 48, 0, False), (4, 48, 14, True)]
)
def test_a_map_of_little_depth_does_not_wait(asked: Asked, mapped: int, rows: int, doubted: int, begins: bool) -> None:
    """It is left for the first view with much depth that it does not find. mapped: rows of its keyframe with depth. doubted: frames."""
    graph = KeyframeGraph(KeyframeConfig(), verify=True)
    first, view = view_at(0.0, 0, mapped), view_at(1.0, 1, rows)
    graph.insert(first)
    recovery = Relocalisation(LoopConfig(submap_after=30), asked, None, graph, FramePoses(graph), StageTimer())  # type: ignore[arg-type]
    recovery.frames.append(0.0, first.T_wk, Status.OK)
    status = Status.DOUBTFUL if doubted else Status.LOST
    found = [recovery.recover(view, Tracked(view.T_wk, status, Source.ALIGNED)).source for _ in range(doubted + 1)]
    assert [source is Source.NEW_SUBMAP for source in found] == [False] * doubted + [begins]
