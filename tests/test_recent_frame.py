"""A recent frame as a reference: when it is used, when a newer one takes its place, and what it does to a pose."""

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
import torch
from torch import Tensor

from idfslam.alignment.aligner import MapAligner
from idfslam.alignment.alignment import Alignment
from idfslam.alignment.landmarks import Landmarks, landmarks
from idfslam.config import AlignmentConfig
from idfslam.frame import Frame, Status
from idfslam.graph.frame_poses import FramePoses
from idfslam.graph.keyframe import Keyframe
from idfslam.slam.front_end.recent_frame import RecentFrame, compiled_within, plain_within
from idfslam.slam.tracked import Evidence, Source, Tracked
from test_displacement import CAMERA, EYE, appearance, turned, wall


def view_at(T_wc: Tensor, index: int) -> Keyframe:
    """A view of the painted wall."""
    shown = wall(T_wc)
    colour, depth = shown.levels[0].luminance[..., None].repeat(1, 1, 3), shown.depth
    frame = Frame(index, index / 30, colour.numpy(), depth.numpy(), CAMERA)
    return Keyframe(frame, T_wc.clone(), depth, colour)


def tracked_at(T_wc: Tensor, in_view: float, status: Status = Status.OK) -> Tracked:
    return Tracked(T_wc, status, Source.ALIGNED, Evidence(in_view=in_view))


class Recents:
    """A recent frame, the aligner that it takes landmarks from, and the poses of the frames so far."""

    def __init__(self) -> None:
        query = lambda points: (2 - points[:, 2], points.new_tensor([0.0, 0, -1]).expand_as(points))  # noqa: E731
        config = AlignmentConfig(image_height=240)
        self.aligner = MapAligner(config, query, 0.1, torch.Generator().manual_seed(0))
        self.poses: list[Tensor] = []
        self.recent = RecentFrame(self.aligner, cast(FramePoses, SimpleNamespace(T_wc=lambda i: self.poses[i])))

    def accept(
        self, T_wc: Tensor, in_view: float, status: Status = Status.OK, keyframe: Keyframe | None = None
    ) -> tuple[Landmarks, Tensor] | None:
        self.recent.accept(view_at(T_wc, len(self.poses)), tracked_at(T_wc, in_view, status), [] if keyframe is None else [keyframe])
        self.poses.append(T_wc)
        return self.recent.reference()


def test_a_recent_frame_is_used_only_where_keyframes_show_little() -> None:
    recents = Recents()
    assert recents.accept(EYE, 0.9) is None
    reference = recents.accept(turned(1), 0.6)
    assert reference is not None and torch.equal(reference[1], turned(1))
    assert recents.accept(turned(2), 0.8) is None


def test_the_compiled_count_is_the_plain_one() -> None:
    points = torch.randn(500, 3, generator=torch.Generator().manual_seed(0))
    normals, offsets = CAMERA.frustum() @ turned(10)[:3, :3].numpy(), np.full(len(CAMERA.frustum()), 0.3)
    assert compiled_within(points, normals, offsets) == plain_within(points, normals, offsets) > 20


def test_landmarks_that_somebody_hides_need_no_recent_frame() -> None:
    """Few of them are seen, but they lie within the view: the camera did not turn away."""
    recents, keyframe = Recents(), view_at(EYE, 0)
    assert recents.accept(turned(5), 0.3, keyframe=keyframe) is None
    assert recents.accept(turned(30), 0.3, keyframe=keyframe) is not None


def test_a_newer_frame_takes_its_place_once_too_little_of_it_is_in_view() -> None:
    recents = Recents()
    places = [recents.accept(turned(degrees), 0.5) for degrees in (0.0, 1.0, 2.0, 6.0)]
    assert [torch.equal(cast(tuple[Landmarks, Tensor], place)[1], EYE) for place in places] == [True, True, True, False]


def test_it_is_forgotten_with_a_lost_frame_and_follows_the_graph() -> None:
    recents = Recents()
    recents.accept(EYE, 0.5)
    recents.poses[0] = turned(5)
    reference = recents.recent.reference()
    assert reference is not None and torch.equal(reference[1], turned(5))
    assert recents.accept(turned(1), 0.5, Status.LOST) is None


def test_its_landmarks_are_its_state() -> None:
    recents, restored = Recents(), Recents()
    recents.accept(EYE, 0.5)
    restored.recent.restore(recents.recent.state())
    restored.poses = recents.poses
    (kept, _), (marks, _) = (cast(tuple[Landmarks, Tensor], r.recent.reference()) for r in (restored, recents))
    assert torch.equal(kept.points, marks.points) and len(kept.slopes) == len(marks.slopes)


def aligned(recents: Recents, view: Keyframe, recent: tuple[Landmarks, Tensor] | None) -> Alignment:
    """The alignment of a view in front of a wall whose brightness no keyframe knows."""
    blank = appearance(torch.full((240, 320, 3), 0.5), torch.full((240, 320), 2.0))
    keyframe = Keyframe(
        Frame(0, 0.0, torch.full((240, 320, 3), 0.5).numpy(), blank.depth.numpy(), CAMERA), EYE, blank.depth, torch.full((240, 320, 3), 0.5)
    )
    return recents.aligner.align(view, EYE, [keyframe], recent=recent)


def test_it_draws_the_pose_and_is_no_evidence() -> None:
    """Along a wall depth says nothing. The keyframe is blank, so the recent frame alone tells the shift of 3 cm."""
    recents, T_true = Recents(), EYE.clone()
    T_true[0, 3] = 0.03
    shown = wall(EYE)
    marks = landmarks(shown.levels, shown.depth, count=3600)
    without, with_it = (aligned(recents, view_at(T_true, 1), recent) for recent in (None, (marks, EYE)))
    assert float(without.T_wc[0, 3]) == pytest.approx(0, abs=1e-3)
    assert float(with_it.T_wc[0, 3]) == pytest.approx(0.03, abs=1e-3)
    assert with_it.photometric_error == without.photometric_error == 0
    assert with_it.in_view == without.in_view
