"""Coverage: the depth that the mapped views observed, to which a mesh is restricted. Each view moves with its host keyframe.

Alignments are restricted to it too (`observed_space`).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from idfslam.fusion.packed_depth import PackedDepth, pack_depth
from idfslam.geometry import se3
from idfslam.geometry.camera import Camera
from idfslam.geometry.depth_view import DepthView, reduced_view
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.keyframe_graph import KeyframeGraph
from idfslam.graph.observed_space import ObservedSpace
from idfslam.storage.state import State, Stateful

# Both were chosen by hand.
_ROWS = 120  # [px] of a view's reduced depth image. More: finer outlines of the observed surface, more memory (77 kB a view at 120 x 160)
_SAME_POSE = 1e-9  # [m], [rad] of a view in its host, below which it is the host itself. More: a view beside it passes for it
EARLIER = -1  # index of a view that is of no frame of the run, but of the map that it started in: a fact of the state's format
_MOST = 1000  # views, beyond which every other one is dropped. More: more memory, and more time for a mesh


@dataclass(frozen=True, eq=False)
class _MappedView:
    """A view that the map learnt from."""

    host: int  # keyframe
    index: int  # of the frame; EARLIER: of another run
    view: DepthView  # reduced, at its pose T_kc in the host, without what moves
    packed: PackedDepth  # more of its depth, with what moves
    hidden: NDArray[np.bool_] | None  # pixels of that which show what moves; None: none

    @classmethod
    def of(cls, view: Keyframe, host: int, T_kc: NDArray[np.float64]) -> "_MappedView":
        """What a view shows at a pose T_kc (4, 4) in its host."""
        packed, camera = pack_depth(view.unmasked.frame.depth, view.camera), view.camera
        hidden = None if view.moving is None else _resized(view.moving, packed.counts.shape)
        return cls(host, view.index, reduced_view(T_kc, view.frame.depth, camera, _ROWS), packed, hidden)

    def without(self, moving: NDArray[np.bool_]) -> "_MappedView":
        """The same view with more pixels of its finer depth that show what moves."""
        coarser = _resized(moving, self.view.depth.shape)
        view = replace(self.view, depth=np.where(coarser, np.float32(0), self.view.depth))
        return replace(self, view=view, hidden=moving if self.hidden is None else moving | self.hidden)

    def placed(self, host: int, T_kc: Tensor) -> "_MappedView":
        """The same view at another pose (4, 4) in a host."""
        return replace(self, host=host, view=replace(self.view, T_wc=T_kc.numpy()))

    def fused(self) -> PackedDepth:
        """The finer depth without what moves."""
        if self.hidden is None:
            return self.packed
        return replace(self.packed, counts=np.where(self.hidden, np.uint16(0), self.packed.counts))


class Coverage(Stateful):
    """Reduced depth images of the views that the map learnt from, and finer ones that are fused at the end."""

    def __init__(self, graph: KeyframeGraph) -> None:
        self.graph = graph
        self._views: list[_MappedView] = []
        self.observed = ObservedSpace()

    def state(self) -> State:
        """The views."""
        return {
            "views": [
                {
                    "keyframe": seen.host,
                    "index": seen.index,
                    "T_kc": torch.from_numpy(seen.view.T_wc),
                    "depth": torch.from_numpy(seen.view.depth),
                    "camera": asdict(seen.view.camera),
                    "packed": torch.from_numpy(seen.packed.counts.view(np.int16)),
                    "unit": seen.packed.unit,
                    "packed_camera": asdict(seen.packed.camera),
                    "hidden": None if seen.hidden is None else torch.from_numpy(np.packbits(seen.hidden)),
                }
                for seen in self._views
            ]
        }

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        self._views = [_revived(kept) for kept in state["views"]]

    def add(self, view: Keyframe) -> None:
        """Adds a view that the map learns from, relative to the host of the last keyframe."""
        host, T_kc = self.graph.relative_to_host(view.T_wk)
        self._append(_MappedView.of(view, host, T_kc.numpy()))
        if len(self._views) > _MOST:
            del self._views[1::2]  # the views left are still spread over the whole run

    def replace(self, keyframe: Keyframe) -> None:
        """Replaces the view of a stored keyframe, whose depth has changed."""
        for i, seen in enumerate(self._views):
            if seen.host == keyframe.host and np.allclose(seen.view.T_wc, np.eye(4), atol=_SAME_POSE):
                self._views[i] = _MappedView.of(keyframe, seen.host, seen.view.T_wc)

    def hide(self, moving: Sequence[NDArray[np.bool_]]) -> None:
        """Takes the depth of what moves out of the views: these pixels (h, w) of the depth of each of `packed`."""
        hidden = {seen: pixels for seen, pixels in zip(self._of_main_submap(), moving) if pixels.any()}
        self._views = [seen.without(hidden[seen]) if seen in hidden else seen for seen in self._views]

    def load(self, views: Sequence[DepthView]) -> None:
        """Adds the views of an earlier run, each relative to the nearest stored keyframe."""
        centres = torch.stack([k.T_wk[:3, 3] for k in self.graph.keyframes]).numpy()
        for view in views:
            k = int(np.linalg.norm(centres - view.T_wc[:3, 3], axis=1).argmin())
            T_kc = se3.inverse(self.graph.keyframes[k].T_wk).numpy() @ view.T_wc
            self._append(_MappedView(k, EARLIER, DepthView(T_kc, view.depth, view.camera), pack_depth(view.depth, view.camera), None))

    def follow(self, keyframes: Sequence[Keyframe]) -> None:
        """Adds the new places of what the views of these keyframes, which have moved, observed."""
        moved = {keyframe.host for keyframe in keyframes}
        for seen in self._views:
            if seen.host in moved:
                self.observed.add(self._posed(seen).points())

    def place(self, in_host: Callable[[int], tuple[int, Tensor]]) -> None:
        """Places the views of this run anew. in_host: the host of a frame, and its pose (4, 4) there (`FramePoses.in_host`)."""
        self._views = [seen if seen.index == EARLIER else seen.placed(*in_host(seen.index)) for seen in self._views]

    def _append(self, seen: _MappedView) -> None:
        self._views.append(seen)
        self.observed.add(self._posed(seen).points())

    def _posed(self, seen: _MappedView) -> DepthView:
        """A view at the present pose of its host keyframe."""
        return replace(seen.view, T_wc=self.graph.keyframes[seen.host].T_wk.numpy() @ seen.view.T_wc)

    def _of_main_submap(self) -> list[_MappedView]:
        main = self.graph.main_submap
        return [seen for seen in self._views if self.graph.keyframes[seen.host].submap == main]

    def views(self) -> list[DepthView]:
        """All views of the main submap, at the present poses of their host keyframes."""
        return [self._posed(seen) for seen in self._of_main_submap()]

    def indices(self) -> list[int]:
        """The frames of the same views; EARLIER for those of another run."""
        return [seen.index for seen in self._of_main_submap()]

    def packed(self) -> list[tuple[NDArray[np.float64], PackedDepth]]:
        """The same views in more rows: pose T_wc (4, 4) and depth, without what moves."""
        return [(self._posed(seen).T_wc, seen.fused()) for seen in self._of_main_submap()]

    def unmasked(self) -> list[tuple[NDArray[np.float64], PackedDepth]]:
        """The same with what moves."""
        return [(self._posed(seen).T_wc, seen.packed) for seen in self._of_main_submap()]

    def finer_views(self) -> Iterator[DepthView]:
        """The views of `packed`, without what moves, unpacked one at a time."""
        return (depth.view(T_wc) for T_wc, depth in self.packed())


def _revived(kept: State) -> _MappedView:
    """The view that a state was made from."""
    packed = PackedDepth(kept["packed"].numpy().view(np.uint16), kept["unit"], Camera(**kept["packed_camera"]))
    shape, bits = packed.counts.shape, kept["hidden"]
    hidden = None if bits is None else np.unpackbits(bits.numpy(), count=packed.counts.size).reshape(shape).astype(np.bool_)
    return _MappedView(
        kept["keyframe"], kept["index"], DepthView(kept["T_kc"].numpy(), kept["depth"].numpy(), Camera(**kept["camera"])), packed, hidden
    )


def _resized(pixels: NDArray[np.bool_], shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """(h, w) whether any of the pixels (H, W) that a pixel covers is set."""
    return np.asarray(cv2.resize(pixels.astype(np.float32), shape[::-1], interpolation=cv2.INTER_AREA) > 0)
