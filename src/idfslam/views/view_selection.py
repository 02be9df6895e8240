"""Which frames of a run the archive keeps: the sharpest of each stretch of motion, thinned out when they exceed the budget.

An image is rectified and compressed in a thread of its own while the next frames are tracked. What is kept does not depend on its speed.
"""

from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from idfslam.frame import Frame
from idfslam.geometry.camera import Camera
from idfslam.geometry.pose_distance import apparent_motions
from idfslam.graph.coverage import EARLIER
from idfslam.graph.frame_poses import FramePoses
from idfslam.graph.keyframe import Keyframe
from idfslam.sensing.rectification import Rectification, rectified
from idfslam.sensing.sharpness import sharpness
from idfslam.storage.state import State, Stateful
from idfslam.views.encoded_view import EncodedView, encode, without
from idfslam.views.image_archive import ImageArchive

# [rad] Motion of the image over a stretch of frames of which the sharpest is kept. More: fewer images, farther from one another. It is a
# few frames of a camera in the hand; the budget decides in most recordings. Chosen by hand
_STRETCH = 0.03
_THINNED = 0.9  # [1] share of the budget down to which the images are thinned out. Less: done less often, more is lost. Chosen by hand
_MEGABYTE = 1e6  # [bytes]


@dataclass(frozen=True, eq=False)
class _Candidate:
    """The sharpest frame of a stretch so far, as it was taken."""

    frame: Frame
    rectification: Rectification | None
    moving: NDArray[np.bool_] | None  # (H, W) pixels that show what moves; None: none
    sharpness: float

    def encoded(self) -> EncodedView:
        frame = self.frame if self.rectification is None else rectified(self.frame, self.rectification)
        return encode(frame, self.sharpness, self.moving)


class ViewSelection(Stateful):
    """Chooses and compresses images while a run goes on. Their poses are those of the frames, so they move with the keyframes."""

    def __init__(self, frames: FramePoses, megabytes: float) -> None:
        """megabytes: the budget [MB]; 0: no image is kept."""
        self.frames, self._budget = frames, megabytes * _MEGABYTE
        self.views: list[EncodedView] = []
        self.camera: Camera | None = None  # of the images
        self._earlier: list[tuple[EncodedView, int, NDArray[np.float64]]] = []  # of an earlier run: host keyframe, pose T_kc in it
        self._pool = ThreadPoolExecutor(1)
        self._running: Future[EncodedView] | None = None  # the image after `views`
        self._best: _Candidate | EncodedView | None = None  # of the present stretch
        self._begun_at: NDArray[np.float64] | None = None  # T_wc (4, 4) at which the present stretch began

    def state(self) -> State:
        """The images, compressed, with the best of the present stretch last."""
        self._settle()
        if isinstance(self._best, _Candidate):
            self._best = self._best.encoded()
        kept = [*self.views, *([] if self._best is None else [self._best])]
        begun = None if self._begun_at is None else torch.from_numpy(self._begun_at)
        earlier = [{"view": _state_of(view), "keyframe": k, "T_kc": torch.from_numpy(T_kc)} for view, k, T_kc in self._earlier]
        camera = None if self.camera is None else asdict(self.camera)
        views = [_state_of(view) for view in kept]
        return {"views": views, "begun_at": begun, "pending": self._best is not None, "earlier": earlier, "camera": camera}

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        views = [_view_of(kept) for kept in state["views"]]
        self._best = views.pop() if state["pending"] else None
        self.views = views
        self._begun_at = None if state["begun_at"] is None else state["begun_at"].numpy().copy()
        self._earlier = [(_view_of(kept["view"]), kept["keyframe"], kept["T_kc"].numpy().copy()) for kept in state["earlier"]]
        self.camera = None if state["camera"] is None else Camera(**state["camera"])

    def load(self, archive: ImageArchive) -> None:
        """Takes over the images of an earlier run, each relative to the nearest stored keyframe, with index -1."""
        self.camera, poses = archive.camera, torch.stack([k.T_wk for k in self.frames.graph.keyframes]).numpy()
        for view, T_wc in zip(archive.views, archive.T_wc):
            k = int(apparent_motions(T_wc, poses).argmin())
            self._earlier.append((replace(view, index=EARLIER), k, np.linalg.inv(poses[k]) @ T_wc))

    def posed(self) -> list[tuple[EncodedView, NDArray[np.float64]]]:
        """All images with their present poses T_wc (4, 4), those of an earlier run first."""
        keyframes = self.frames.graph.keyframes
        earlier = [(view, keyframes[k].T_wk.numpy() @ T_kc) for view, k, T_kc in self._earlier]
        return [*earlier, *((view, self.frames.T_wc(view.index).numpy()) for view in self.views)]

    def add(self, view: Keyframe, of_view: float | None) -> None:
        """Takes the last frame into account, whose pose is trusted and whose image may be shown; of_view: its sharpness, if known."""
        if not self._budget:
            return
        if self.camera != view.camera:
            self.camera, self._earlier = view.camera, []  # an archive has images of one camera
        T_wc = self.frames.T_wc(-1).numpy()
        of_view = sharpness(view.taken.frame.colour) if of_view is None else of_view
        if self._best is None or of_view > self._best.sharpness:
            self._best = _Candidate(view.taken.frame, view.rectification_of_taken, view.moving, of_view)
        if self._begun_at is None or float(apparent_motions(self._begun_at, T_wc[None])[0]) > _STRETCH:
            self._keep()
            self._begun_at = T_wc

    def hide(self, number: int, moving: NDArray[np.bool_]) -> None:
        """Hides what moves in the `number`-th of `views`: cells (h, w), of the pixels of its depth or coarser ones."""
        self.views[number] = without(self.views[number], moving)

    def finish(self) -> None:
        """Ends the last stretch."""
        if self._best is not None:
            self._keep()
        self._settle()

    def _keep(self) -> None:
        self._settle()
        best, self._best = self._best, None
        assert best is not None
        self._running = self._pool.submit(best.encoded if isinstance(best, _Candidate) else lambda: best)

    def _settle(self) -> None:
        """Waits for the image that is being compressed, and sees to the budget."""
        if self._running is None:
            return
        self.views.append(self._running.result())
        self._running = None
        if sum(view.size for view, _ in self.posed()) > self._budget:
            self._thin()

    def _thin(self) -> None:
        """Drops the less sharp one of the two most similar views, again and again."""
        views, poses = [view for view, _ in self.posed()], np.stack([T_wc for _, T_wc in self.posed()])
        apart = np.stack([apparent_motions(T, poses) for T in poses])
        np.fill_diagonal(apart, np.inf)
        left, size = np.full(len(poses), True), sum(view.size for view in views)
        while size > _THINNED * self._budget and left.sum() > 1:
            pair = np.unravel_index(int(apart.argmin()), apart.shape)
            worse = int(min(pair, key=lambda i: views[i].sharpness))
            left[worse] = False
            apart[worse] = apart[:, worse] = np.inf
            size -= views[worse].size
        self._earlier = [kept for kept, keep in zip(self._earlier, left) if keep]
        self.views = [view for view, keep in zip(views, left) if keep and view.index != EARLIER]


def _state_of(view: EncodedView) -> State:
    colour, depth = (torch.from_numpy(np.frombuffer(data, np.uint8).copy()) for data in (view.colour, view.depth))
    return {"index": view.index, "colour": colour, "depth": depth, "sharpness": view.sharpness}


def _view_of(kept: State) -> EncodedView:
    return EncodedView(kept["index"], kept["colour"].numpy().tobytes(), kept["depth"].numpy().tobytes(), kept["sharpness"])
