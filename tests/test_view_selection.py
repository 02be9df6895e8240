"""Which frames the archive keeps."""

import cv2
import numpy as np
import torch

from helpers.flat_wall import wall_graph
from helpers.grey_archive import grey_archive
from helpers.painted_wall import at, painted
from idfslam.frame import Frame, Status
from idfslam.geometry.pose_distance import apparent_motions
from idfslam.graph.frame_poses import FramePoses
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.swap_file import SwapFile
from idfslam.sensing.rectification import Rectification, RowTimes
from idfslam.views.encoded_view import MOVING, decode_depth, encode
from idfslam.views.image_archive import archive_of
from idfslam.views.view_selection import ViewSelection


def view_of(frame: Frame, T_wc: np.ndarray) -> Keyframe:
    return Keyframe(frame, torch.from_numpy(T_wc), torch.from_numpy(frame.depth), torch.from_numpy(frame.colour))


def filmed(xs: list[float], blurred: tuple[int, ...] = (), megabytes: float = 20.0) -> ViewSelection:
    """A selection after frames at places x [m] along the wall."""
    selection = ViewSelection(FramePoses(wall_graph(places=(0.0,))), megabytes)
    for i, x in enumerate(xs):
        feed(selection, i, x, i in blurred)
    selection.finish()
    return selection


def feed(selection: ViewSelection, i: int, x: float, blurred: bool = False) -> None:
    frame = painted(i, at(x))
    if blurred:
        frame = Frame(i, i / 30, cv2.blur(frame.colour, (9, 9)), frame.depth, frame.camera)
    selection.frames.append(i / 30, torch.from_numpy(at(x)), Status.OK)
    selection.add(view_of(frame, at(x)), None)


def test_a_camera_at_rest_gives_two_images() -> None:
    assert len(filmed([0.0] * 20).views) == 2  # the first frame, and the best of those after it


def test_a_moving_camera_gives_one_in_each_stretch() -> None:
    indices = [view.index for view in filmed([0.013 * i for i in range(40)]).views]
    assert len(indices) == 9  # the first frame, seven stretches of five frames (0.0325 rad), and the rest
    assert indices[0] == 0


def test_the_sharp_frame_of_a_stretch_is_kept() -> None:
    blurred = tuple(i for i in range(40) if i % 5)
    views = filmed([0.013 * i for i in range(40)], blurred).views[:-1]  # without the rest after the last stretch
    assert [view.index for view in views] == [0, 5, 10, 15, 20, 25, 30, 35]


def test_the_budget_holds_and_what_is_alike_goes_first() -> None:
    back_and_forth = [0.2 * i for i in range(10)] + [0.2 * (9 - i) + 0.01 for i in range(10)]
    full = filmed(back_and_forth)
    assert len(full.views) == 19  # the two frames at the turn are one stretch
    budget = 0.55 * sum(view.size for view in full.views) / 1e6
    small = filmed(back_and_forth, megabytes=budget)
    assert sum(view.size for view in small.views) <= budget * 1e6
    places = sorted(back_and_forth[view.index] for view in small.views)
    assert np.diff(places).max() < 0.45  # every place is still seen by one within 0.2 m


def test_images_are_rectified_once() -> None:
    """Those of a stored keyframe are rectified already."""
    view = view_of(painted(0, at(0.0)), at(0.0))
    assert view.rectification_of_taken is None
    view.rectify(Rectification(RowTimes(0.03, 0.03, 0.0), np.array([0, 0, 0, 0, 1.0, 0])))
    assert view.rectification_of_taken is view.rectification is not None
    view.keep_in(SwapFile(4), 0)
    assert view.rectification_of_taken is None


def test_no_budget_keeps_nothing() -> None:
    assert filmed([0.0, 0.5, 1.0], megabytes=0.0).views == []


def test_a_restored_selection_goes_on_as_the_first() -> None:
    whole, first = filmed([0.05 * i for i in range(12)]), filmed([])
    for i in range(7):
        feed(first, i, 0.05 * i)
    second = ViewSelection(first.frames, 20.0)
    second.restore(first.state())
    for i in range(7, 12):
        feed(second, i, 0.05 * i)
    second.finish()
    assert [(v.index, v.colour, v.depth, v.sharpness) for v in second.views] == [
        (v.index, v.colour, v.depth, v.sharpness) for v in whole.views
    ]


def test_images_of_an_earlier_run_move_with_their_keyframes() -> None:
    selection = ViewSelection(FramePoses(wall_graph(places=(0.0, 1.0))), 20.0)
    frames = [painted(i, at(x)) for i, x in enumerate((0.05, 1.1))]
    selection.load(archive_of([encode(frame, 0.5) for frame in frames], frames[0].camera, np.stack([at(0.05), at(1.1)])))
    feed(selection, 0, 0.0)
    selection.finish()
    selection.frames.graph.keyframes[0].T_wk = torch.from_numpy(at(0.0, 0.3))  # the only stored one: frames move with it too
    posed = selection.posed()
    assert [view.index for view, _ in posed] == [-1, -1, 0]
    np.testing.assert_allclose([T[:2, 3] for _, T in posed], [(0.05, 0.3), (1.1, 0.3), (0, 0.3)], atol=1e-12)


def test_those_of_another_camera_are_left_out() -> None:
    selection = ViewSelection(FramePoses(wall_graph(places=(0.0, 1.0))), 20.0)
    selection.load(grey_archive())
    feed(selection, 0, 0.0)
    selection.finish()
    assert [view.index for view, _ in selection.posed()] == [0]


def test_motion_of_the_image() -> None:
    np.testing.assert_allclose(
        apparent_motions(at(0.0), np.stack([at(0.5), at(0.0, 0.0, 0.1), at(0.2, 0.0, 0.1)])), [0.25, 0.1, 0.2], atol=1e-6
    )


def test_what_moved_is_hidden_later() -> None:
    selection = filmed([0.0] * 5)
    before = decode_depth(selection.views[1].depth)
    cells = np.zeros((before.shape[0] // 2, before.shape[1] // 2), np.bool_)
    cells[3:5, 7] = True
    selection.hide(1, cells)
    after = decode_depth(selection.views[1].depth)
    assert (after[6:10, 14:16] == MOVING).all()
    assert (after == MOVING).sum() == 8
    np.testing.assert_array_equal(after[after != MOVING], before[after != MOVING])
