"""The crisp surface at the end of a run: keyframes and mapped views, at their final poses, fused into one volume."""

from abc import ABC, abstractmethod
from collections.abc import Iterator

from idfslam.config import FusionConfig
from idfslam.fusion.fuse import fuse, in_random_order
from idfslam.fusion.tsdf_volume import TsdfVolume
from idfslam.geometry.depth_view import DepthView
from idfslam.graph.coverage import Coverage
from idfslam.graph.keyframe_graph import KeyframeGraph


class SurfaceFusion(ABC):
    """Makes the volume that is blended with the map's network."""

    @abstractmethod
    def volume(self) -> TsdfVolume | None:
        """The volume at the present poses; None: the surface is the network's alone."""


class NoFusion(SurfaceFusion):
    """No volume, as in the paper."""

    def volume(self) -> TsdfVolume | None:
        return None


class ViewFusion(SurfaceFusion):
    """Fuses the keyframes with all of their rows, and the views of the coverage. What moves is in none of them."""

    def __init__(self, config: FusionConfig, graph: KeyframeGraph, coverage: Coverage) -> None:
        self.config, self.graph, self.coverage = config, graph, coverage

    def volume(self) -> TsdfVolume | None:
        return fuse(self.coverage.views(), self.config.voxel, self.config.blocks, readings=self._readings())

    def _readings(self) -> Iterator[DepthView]:
        """Keyframes and views, finest first, one at a time."""
        main = self.graph.main_submap
        for keyframe in self.graph.keyframes:
            if keyframe.submap == main:
                yield DepthView(keyframe.T_wk.numpy(), keyframe.frame.depth, keyframe.camera)
        for T_wc, depth in in_random_order(self.coverage.packed()):
            yield depth.view(T_wc)
