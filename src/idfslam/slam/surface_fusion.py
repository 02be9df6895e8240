"""The crisp surface at the end of a run: mapped views, keyframes and archived images, at their final poses, fused into one volume."""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from itertools import chain

from idfslam.config import FusionConfig
from idfslam.fusion.fuse import fuse
from idfslam.fusion.tsdf_volume import TsdfVolume
from idfslam.geometry.depth_view import DepthView
from idfslam.graph.coverage import Coverage
from idfslam.graph.keyframe_graph import KeyframeGraph


class SurfaceFusion(ABC):
    """Makes the volume that is blended with the map's network."""

    @abstractmethod
    def volume(self, archived: Sequence[DepthView]) -> TsdfVolume | None:
        """The volume at the present poses, with the depth of archived images; None: the surface is the network's alone."""


class NoFusion(SurfaceFusion):
    """No volume, as in the paper."""

    def volume(self, archived: Sequence[DepthView]) -> TsdfVolume | None:
        return None


class ViewFusion(SurfaceFusion):
    """Fuses the views of the coverage, the keyframes with all of their rows, and archived images. What moves is in none of them."""

    def __init__(self, config: FusionConfig, graph: KeyframeGraph, coverage: Coverage) -> None:
        self.config, self.graph, self.coverage = config, graph, coverage

    def volume(self, archived: Sequence[DepthView]) -> TsdfVolume | None:
        return fuse(self.coverage.views(), self.config.voxel, self.config.blocks, more=chain(self._keyframes(), archived))

    def _keyframes(self) -> Iterator[DepthView]:
        """The keyframes of the first submap. Their images come from the archive one at a time."""
        for keyframe in self.graph.keyframes:
            if keyframe.submap == 0:
                yield DepthView(keyframe.T_wk.numpy(), keyframe.frame.depth, keyframe.camera)
