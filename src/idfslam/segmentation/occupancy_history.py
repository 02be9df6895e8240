"""When space was free and when it was occupied, as the stored views of a run saw it: what they show of things that did not stay.

Readings are gathered in voxels. Each view tells of a voxel's mean reading that something is there, or that it saw through it. Space that
was free once is no part of what stands, however many views show something in it. This is the free space of OctoMap (Hornung et al.,
Autonomous Robots 2013) without its probabilities, since what moves may be seen in one place for long.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from idfslam.geometry.blocks import pack
from idfslam.segmentation.coarse_view import CoarseView
from idfslam.segmentation.constants import SIGMAS, SLACK
from idfslam.segmentation.free_space import projected, sigma
from idfslam.segmentation.plain_form import compiles
from idfslam.segmentation.region_growing import grown
from idfslam.segmentation.smooth_continuation import continued, valleys
from idfslam.segmentation.witnesses import STANDS

Array = NDArray[np.float64]
Cells = NDArray[np.bool_]
Counts = NDArray[np.int32]

# All of them were chosen by hand on generated rooms.
_VOXEL = 0.04  # [m] edge. More: faster, and what stands near what moved is taken for it
_LEAST = 2  # views that must have seen through a voxel. More: surer, and less of what was seen through seldom is found
_SHARE = 0.1  # [1] of the views that know a voxel that must have seen through it. More: likewise, where something stood for long
# [frames] before or after a view from which on something seen where no view saw through is known to stay. More: regions spread over more of
# what was seen for a short time only
_STAYS = 60
# [cells] that a region grows from what was seen through of it. More: more of a body at once, and of the floor that it stands on
_BEGINS = 4
# [cells] that a body reaches from there, over what was seen while it was there and at no other time. With 24 and 32 cells 4.6 and 3.3 % of
# the bodies were missed in room 1, 8.7 and 7.8 % in room 3, and 0.56 and 0.68 % of what stands were masked where a door and a chair move.
# More: more of one who stood, whose legs nobody saw through, and more of what was seen as briefly as a body
_REACHES = 32
# [cells] that bodies grow over the valleys at which they end, which are as wide: arms have some against a chest. In five rooms 322 to 975
# cells of 5 cm showed parts of bodies without, 304 to 891 with it. More: more of the floor at their feet
_CLOSES = 2
# [1] share of the voxels seen through of a body that must have been seen by a time for it to be there then. More: a single one that passes
# for a part of it widens its time (1.25 instead of 0.22 % of what stands in room 3); less: parts are missed
_THERE = 0.9


@dataclass(frozen=True)
class StoredView:
    """A coarse view, its camera-to-world pose (4, 4), and the number of its frame."""

    view: CoarseView
    T_wc: Array
    number: int


@dataclass(frozen=True)
class OccupancyHistory:
    """What N voxels that have readings were in the course of a run."""

    keys: NDArray[np.int64]  # (N,) of the voxels, sorted
    through: Counts  # (N,) number of views that saw through a voxel's mean reading
    seen: Counts  # (N,) number of views that saw something there
    free: Counts  # (N,) number of the last frame that saw through it; -1: none
    first: Counts  # (N,) number of the first frame that saw something there
    last: Counts  # (N,) number of the last frame that saw something there; -1: none

    @classmethod
    def of(cls, views: Sequence[StoredView]) -> "OccupancyHistory":
        """The history that views tell."""
        points = np.concatenate([np.empty((0, 3)), *(_points(stored)[0] for stored in views)])
        keys, voxel, count = np.unique(_voxels(points), return_inverse=True, return_counts=True)
        means = np.stack([np.bincount(voxel, points[:, axis], len(keys)) for axis in range(3)], -1) / count[:, None]
        counts = [np.full(len(keys), start, np.int32) for start in (0, 0, -1, np.iinfo(np.int32).max, -1)]
        look = compiled_look if compiles() else plain_look
        for stored in views:
            look(stored, means, *counts)
        return cls(keys, *counts)

    def moving(self, stored: StoredView) -> Cells:
        """(h, w) the cells of a view that show what did not stay: voxels that were free at another time, with their bodies."""
        depth, number = stored.view.depth, stored.number
        if not len(self.keys):
            return np.zeros(depth.shape, np.bool_)
        cells = self._cells(stored)
        ends, free, unviolated = valleys(depth), cells(self._was_free(number)), cells(self.through == 0)
        first, last = cells(self.first), cells(self.last)
        found = grown(free, cells(self._stays(number)) | ends, depth, _BEGINS)
        count, regions = cv2.connectedComponents(found.astype(np.uint8))
        for region in (regions == k for k in range(1, count)):
            came, left = np.quantile(first[region & free], 1 - _THERE), np.quantile(last[region & free], _THERE)
            others = unviolated & ((first < came) | (last > left)) & ~found  # seen before it came, or after it had left
            bounds = (others | ends) & ~found & (depth > 0)
            body = grown(region, continued(bounds, unviolated & ~bounds & ~found, depth), depth, _REACHES)
            found = found | body | grown(body, others, depth, _CLOSES)
        return found

    def _cells(self, stored: StoredView) -> Callable[[NDArray[Any]], NDArray[Any]]:
        """What gives values (N,) of voxels as an image (h, w) of a view's cells; 0 where they show no known voxel."""
        points, where = _points(stored)
        wanted = _voxels(points)
        row = np.minimum(np.searchsorted(self.keys, wanted), len(self.keys) - 1)
        known = self.keys[row] == wanted

        def cells(values: NDArray[Any]) -> NDArray[Any]:
            image = np.zeros(stored.view.depth.shape, values.dtype)
            image[where] = np.where(known, values[row], 0)
            return image

        return cells

    def _was_free(self, number: int) -> Cells:
        """(N,) whether voxels were free at another time than that of a frame, and what is there then does not stand there since."""
        enough = (self.through >= _LEAST) & (self.through >= _SHARE * (self.through + self.seen))
        stands = (self.free < number) & (self.last - self.free >= STANDS)
        return enough & ~stands

    def _stays(self, number: int) -> Cells:
        """(N,) whether what is seen in voxels in a frame is there long before or after, too, and no view saw through it."""
        return (self.through == 0) & ((number - self.first >= _STAYS) | (self.last - number >= _STAYS))


def compiled_look(stored: StoredView, means: Array, through: Counts, seen: Counts, free: Counts, first: Counts, last: Counts) -> None:
    """`plain_look` by Numba."""
    from idfslam.segmentation.kernels import numba_segmentation

    a, c, T_cw = stored.view, stored.view.camera, np.linalg.inv(stored.T_wc)
    camera = np.array([c.fx, c.fy, c.cx, c.cy])
    numba_segmentation.look(means, a.depth, a.near, a.far, camera, T_cw, stored.number, through, seen, free, first, last)  # type: ignore[call-arg]


def plain_look(stored: StoredView, means: Array, through: Counts, seen: Counts, free: Counts, first: Counts, last: Counts) -> None:
    """Adds to the voxels (N,) of means (N, 3) [m] what a view says of them, in numpy."""
    view, T_cw = stored.view, np.linalg.inv(stored.T_wc)
    inside, row, column, r = projected(means @ T_cw[:3, :3].T + T_cw[:3, 3], view.camera)
    near, margin = view.near[row, column], SLACK + 2 * SIGMAS * sigma(r)
    gone = inside & np.isfinite(near) & (r < near - margin)
    at = view.depth[row, column]
    there = inside & ~gone & (at > 0) & (r > np.where(np.isfinite(near), near, at) - margin) & (r < view.far[row, column] + margin)
    through += gone
    seen += there
    free[gone] = np.maximum(free[gone], stored.number)
    first[there] = np.minimum(first[there], stored.number)
    last[there] = np.maximum(last[there], stored.number)


def _points(stored: StoredView) -> tuple[Array, tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """The points (M, 3) [m] in the world of a view's cells with a reading, and their rows and columns."""
    v, u = np.nonzero(stored.view.depth)
    z, c = stored.view.depth[v, u].astype(np.float64), stored.view.camera
    return np.stack([(u - c.cx) / c.fx * z, (v - c.cy) / c.fy * z, z], -1) @ stored.T_wc[:3, :3].T + stored.T_wc[:3, 3], (v, u)


def _voxels(points: Array) -> NDArray[np.int64]:
    return pack(np.floor(points / _VOXEL))
