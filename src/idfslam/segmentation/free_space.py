"""What other views say of each cell of a view: whether its point lies in space that they saw through, or on a surface that they see.

A point that lies before the surface that another view sees in its direction was not there then, or is not there any more: it moves.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from idfslam.geometry.camera import Camera
from idfslam.segmentation.coarse_view import CoarseView
from idfslam.segmentation.constants import (
    COMPARABLE,
    CONTRAST,
    NEAREST_SEEN,
    SIGMAS,
    SLACK,
    STEP,
    USUAL,
)
from idfslam.segmentation.plain_form import compiles, form
from idfslam.sensing.depth_noise import BEST, GROWTH, NEAREST

Array = NDArray[np.float64]
Counts = NDArray[np.int32]
Cells = NDArray[np.bool_]


@dataclass(frozen=True)
class PosedView:
    """A coarse view, its camera-to-world pose (4, 4), and the cells (h, w) of it that are known to show what moves."""

    view: CoarseView
    T_wc: Array
    moving: Cells
    testifies: bool = True  # False: it was taken about when the view was, so that its seeing the same says nothing
    settles: bool = False  # True: it was taken so long before that what it sees in the same place stands there


@dataclass(frozen=True)
class Votes:
    """The numbers of views (h, w) that saw through a cell's point, and of those that see a surface of its brightness there."""

    through: Counts
    seen: Counts  # in cells that do not move
    agree: Counts  # in any cells
    stands: Cells  # whether one of them saw it long before, and none saw through it since
    by: Sequence[Cells]  # for each view, the cells (h, w) whose points it saw through

    @property
    def moves(self) -> Cells:
        """Cells whose points most of the views that know the place saw through."""
        return (self.through > self.seen) & ~self.stands

    @property
    def held(self) -> Cells:
        """Cells whose points at least as many views see, in cells that do not move, as saw through them."""
        return self.stands | ((self.seen > 0) & (self.seen >= self.through))

    @property
    def stays(self) -> Cells:
        """Cells whose points at least as many views see. What moved stays too if no view saw through it and one sees it where it was."""
        return self.held | ((self.agree > 0) & (self.through == 0))


def votes(view: CoarseView, T_wc: Array, others: Sequence[PosedView]) -> Votes:
    """The votes of `others` on the cells of a view at a pose (4, 4).

    Another view whose surfaces lie farther from the view's than noise explains widens its tolerance by that: its pose, or the view's, is
    off. One that most of the view violates says nothing.
    """
    from idfslam.segmentation.kernels import numba_segmentation

    shape = view.depth.shape
    through, seen, agree = np.zeros((3, *shape), np.int32)
    stood, gone_since = np.zeros((2, *shape), np.bool_)
    by, vote, count_votes = list[Cells](), compiled_vote if compiles() else plain_vote, form(numba_segmentation.count_votes)
    to_others = np.linalg.inv(np.array([other.T_wc for other in others]).reshape(-1, 4, 4))
    for other, T_ow in zip(others, to_others):
        gone, there, fixed = np.zeros((3, *shape), np.bool_)
        known = vote(view, other, T_ow @ T_wc, gone, there, fixed)
        count_votes(known, gone, there, fixed, other.testifies, other.settles, through, seen, agree, stood, gone_since)
        by.append(gone)
    return Votes(through, seen, agree, stood & ~gone_since, by)


def compiled_vote(view: CoarseView, other: PosedView, T_oc: Array, gone: Cells, there: Cells, fixed: Cells) -> int:
    """`plain_vote` by Numba."""
    from idfslam.segmentation.kernels import numba_segmentation

    a, b = view, other.view
    images = b.depth, b.near, b.far, b.brightness, b.dark, b.bright, other.moving
    return int(numba_segmentation.vote(a.depth, a.brightness, *images, *intrinsics(a.camera, b.camera), T_oc, gone, there, fixed))  # type: ignore[call-arg]


def intrinsics(a: Camera, b: Camera) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """1 / fx, 1 / fy, cx, cy of a camera, and fx, fy, cx, cy of another one: what compiled loops take points from one to the other with."""
    return (1 / a.fx, 1 / a.fy, a.cx, a.cy), (b.fx, b.fy, b.cx, b.cy)


def plain_vote(view: CoarseView, other: PosedView, T_oc: Array, gone: Cells, there: Cells, fixed: Cells) -> int:
    """Sets in `gone`, `there` and `fixed` (h, w) what another view says of the cells; returns of how many it knows something. In numpy."""
    b, z = other.view, view.depth.astype(np.float64)
    inside, row, column, r = seen_at(view, b.camera, T_oc)
    at = b.depth[row, column].astype(np.float64)
    noise = sigma(z) + sigma(r)
    same = inside & (at > 0) & (np.abs(r - at) < COMPARABLE)
    sample = np.zeros_like(same)
    sample[::STEP, ::STEP] = same[::STEP, ::STEP]
    spread, gain = 1.0, 1.0
    if sample.any():
        spread = max(1.0, float(np.median((np.abs(r - at) / noise)[sample])) / USUAL)
        brightness = b.brightness[row, column][sample].sum(dtype=np.float64)
        gain = float(view.brightness[sample].sum(dtype=np.float64) / max(brightness, 1e-6))
    margin = SLACK + SIGMAS * spread * noise
    near, far = b.near[row, column], b.far[row, column]
    gone[:] = inside & np.isfinite(near) & (r < near - margin)
    nearest = np.where(np.isfinite(near), near, at)
    on = inside & ~gone & (at > 0) & (r > nearest - margin) & (r < far + margin)
    dark, bright = gain * b.dark[row, column] - CONTRAST, gain * b.bright[row, column] + CONTRAST
    there[:] = on & (view.brightness >= dark) & (view.brightness <= bright)
    fixed[:] = there & ~other.moving[row, column]
    return int((gone | on).sum())


def seen_at(view: CoarseView, camera: Camera, T_oc: Array) -> tuple[Cells, NDArray[np.int64], NDArray[np.int64], Array]:
    """(h, w) each: whether another camera has a cell's point in view; its row, column and depth [m] there. T_oc (4, 4): view to camera."""
    v, u = np.mgrid[: view.camera.height, : view.camera.width]
    z = view.depth.astype(np.float64)
    rays = np.stack([(u - view.camera.cx) / view.camera.fx, (v - view.camera.cy) / view.camera.fy, np.ones_like(z)], -1)
    inside, row, column, r = projected((rays * z[..., None]) @ T_oc[:3, :3].T + T_oc[:3, 3], camera)
    return inside & (z > 0), row, column, r


def projected(p: Array, camera: Camera) -> tuple[Cells, NDArray[np.int64], NDArray[np.int64], Array]:
    """Whether a camera has points p (..., 3) [m] of its frame in view, their rows and columns (0 elsewhere), and their depths [m]."""
    ahead = np.maximum(p[..., 2], 1e-6)
    x, y = p[..., 0] / ahead * camera.fx + camera.cx, p[..., 1] / ahead * camera.fy + camera.cy
    inside = (p[..., 2] > NEAREST_SEEN) & (x >= -0.5) & (y >= -0.5) & (x < camera.width - 0.5) & (y < camera.height - 0.5)
    column, row = (np.floor(np.where(inside, place, 0) + 0.5).astype(np.int64) for place in (x, y))
    return inside, row, column, p[..., 2]


def sigma(z: Array) -> Array:
    """[m] the deviation of readings at depth z [m]."""
    return np.asarray(BEST * (1 + GROWTH * np.maximum(z - NEAREST, 0) ** 2))
