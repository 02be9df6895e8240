"""Coverage: the depth that the mapped views observed, to which a mesh is restricted. Each view moves with its host keyframe.

Alignments are restricted to it too (`observed_space`).
"""

from collections.abc import Sequence
from dataclasses import asdict

import numpy as np
import torch

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


class Coverage(Stateful):
    """Reduced depth images of the views that the map learnt from."""

    def __init__(self, graph: KeyframeGraph) -> None:
        self.graph = graph
        self._views: list[tuple[int, DepthView]] = []  # host keyframe, and the view at its pose T_kc in the host
        self.observed = ObservedSpace()

    def state(self) -> State:
        """The views."""
        return {
            "views": [
                {"keyframe": k, "T_kc": torch.from_numpy(view.T_wc), "depth": torch.from_numpy(view.depth), "camera": asdict(view.camera)}
                for k, view in self._views
            ]
        }

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        self._views = [
            (kept["keyframe"], DepthView(kept["T_kc"].numpy(), kept["depth"].numpy(), Camera(**kept["camera"]))) for kept in state["views"]
        ]

    def add(self, view: Keyframe) -> None:
        """Adds a view that the map learns from, relative to the host of the last keyframe."""
        host, T_kc = self.graph.relative_to_host(view.T_wk)
        self._append(host, reduced_view(T_kc.numpy(), view.frame.depth, view.frame.camera, _ROWS))
        if len(self._views) > _MOST:
            del self._views[1::2]  # the views left are still spread over the whole run

    def replace(self, keyframe: Keyframe) -> None:
        """Replaces the view of a stored keyframe, whose depth has changed."""
        for i, (host, view) in enumerate(self._views):
            if host == keyframe.host and np.allclose(view.T_wc, np.eye(4), atol=_SAME_POSE):
                self._views[i] = host, reduced_view(view.T_wc, keyframe.frame.depth, keyframe.camera, _ROWS)

    def load(self, views: Sequence[DepthView]) -> None:
        """Adds the views of an earlier run, each relative to the nearest stored keyframe."""
        centres = torch.stack([k.T_wk[:3, 3] for k in self.graph.keyframes]).numpy()
        for view in views:
            k = int(np.linalg.norm(centres - view.T_wc[:3, 3], axis=1).argmin())
            T_kc = se3.inverse(self.graph.keyframes[k].T_wk).numpy() @ view.T_wc
            self._append(k, DepthView(T_kc, view.depth, view.camera))

    def follow(self, keyframes: Sequence[Keyframe]) -> None:
        """Adds the new places of what the views of these keyframes, which have moved, observed."""
        moved = {keyframe.host for keyframe in keyframes}
        for host, view in self._views:
            if host in moved:
                self.observed.add(self._posed(host, view).points())

    def _append(self, host: int, view: DepthView) -> None:
        self._views.append((host, view))
        self.observed.add(self._posed(host, view).points())

    def _posed(self, host: int, view: DepthView) -> DepthView:
        """A view at the present pose of its host keyframe."""
        return DepthView(self.graph.keyframes[host].T_wk.numpy() @ view.T_wc, view.depth, view.camera)

    def views(self) -> list[DepthView]:
        """All views of the first submap, at the present poses of their host keyframes."""
        return [self._posed(host, view) for host, view in self._views if self.graph.keyframes[host].submap == 0]
