"""Coverage: the depth that the mapped views observed, to which a mesh is restricted. Each view moves with its host keyframe.

Alignments are restricted to it too (`observed_space`).
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

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
_MOST = 1000  # views, beyond which every other one is dropped. More: more memory, and more time for a mesh


@dataclass(frozen=True, eq=False)
class _Seen:
    """A view that the map learnt from."""

    host: int  # keyframe
    view: DepthView  # reduced, at its pose T_kc in the host
    packed: PackedDepth  # more of its depth, for fusion


class Coverage(Stateful):
    """Reduced depth images of the views that the map learnt from, and finer ones that are fused at the end."""

    def __init__(self, graph: KeyframeGraph) -> None:
        self.graph = graph
        self._views: list[_Seen] = []
        self.observed = ObservedSpace()

    def state(self) -> State:
        """The views."""
        return {
            "views": [
                {
                    "keyframe": seen.host,
                    "T_kc": torch.from_numpy(seen.view.T_wc),
                    "depth": torch.from_numpy(seen.view.depth),
                    "camera": asdict(seen.view.camera),
                    "packed": torch.from_numpy(seen.packed.counts.view(np.int16)),
                    "unit": seen.packed.unit,
                    "packed_camera": asdict(seen.packed.camera),
                }
                for seen in self._views
            ]
        }

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        self._views = [
            _Seen(
                kept["keyframe"],
                DepthView(kept["T_kc"].numpy(), kept["depth"].numpy(), Camera(**kept["camera"])),
                PackedDepth(kept["packed"].numpy().view(np.uint16), kept["unit"], Camera(**kept["packed_camera"])),
            )
            for kept in state["views"]
        ]

    def add(self, view: Keyframe) -> None:
        """Adds a view that the map learns from, relative to the host of the last keyframe."""
        host, T_kc = self.graph.relative_to_host(view.T_wk)
        depth, camera = view.frame.depth, view.frame.camera
        self._append(_Seen(host, reduced_view(T_kc.numpy(), depth, camera, _ROWS), pack_depth(depth, camera)))
        if len(self._views) > _MOST:
            del self._views[1::2]  # the views left are still spread over the whole run

    def replace(self, keyframe: Keyframe) -> None:
        """Replaces the view of a stored keyframe, whose depth has changed."""
        depth, camera = keyframe.frame.depth, keyframe.camera
        for i, seen in enumerate(self._views):
            if seen.host == keyframe.host and np.allclose(seen.view.T_wc, np.eye(4), atol=_SAME_POSE):
                self._views[i] = _Seen(seen.host, reduced_view(seen.view.T_wc, depth, camera, _ROWS), pack_depth(depth, camera))

    def load(self, views: Sequence[DepthView]) -> None:
        """Adds the views of an earlier run, each relative to the nearest stored keyframe."""
        centres = torch.stack([k.T_wk[:3, 3] for k in self.graph.keyframes]).numpy()
        for view in views:
            k = int(np.linalg.norm(centres - view.T_wc[:3, 3], axis=1).argmin())
            T_kc = se3.inverse(self.graph.keyframes[k].T_wk).numpy() @ view.T_wc
            self._append(_Seen(k, DepthView(T_kc, view.depth, view.camera), pack_depth(view.depth, view.camera)))

    def follow(self, keyframes: Sequence[Keyframe]) -> None:
        """Adds the new places of what the views of these keyframes, which have moved, observed."""
        moved = {keyframe.host for keyframe in keyframes}
        for seen in self._views:
            if seen.host in moved:
                self.observed.add(self._posed(seen).points())

    def _append(self, seen: _Seen) -> None:
        self._views.append(seen)
        self.observed.add(self._posed(seen).points())

    def _posed(self, seen: _Seen) -> DepthView:
        """A view at the present pose of its host keyframe."""
        return replace(seen.view, T_wc=self.graph.keyframes[seen.host].T_wk.numpy() @ seen.view.T_wc)

    def _of_first_submap(self) -> list[_Seen]:
        return [seen for seen in self._views if self.graph.keyframes[seen.host].submap == 0]

    def views(self) -> list[DepthView]:
        """All views of the first submap, at the present poses of their host keyframes."""
        return [self._posed(seen) for seen in self._of_first_submap()]

    def packed(self) -> list[tuple[NDArray[np.float64], PackedDepth]]:
        """The same views in more rows: pose T_wc (4, 4) and depth."""
        return [(self._posed(seen).T_wc, seen.packed) for seen in self._of_first_submap()]
