"""Protocols of mesh evaluation: the rules by which publications measure a reconstructed surface.

Publications differ in what counts as surface, and this moves the numbers by centimetres. Every number therefore carries the name of its
protocol:

- `seen` (ours, the default): the surface that the recording shows. Reconstruction: faces in a frustum that the reconstruction itself does
  not hide (margin 3 cm). Completion: true points that are seen by the same rule. All evaluated frames. The depth range is 0.1 to 10 m,
  limited to the depths that the sensor read (`depth_range`: all readings but a thousandth at either end), because surface beyond the reach
  of the sensor is not in the recording; without the recording it is 0.1 to 10 m. Distances are to the surface, not to sampled points: a
  perfect reconstruction has accuracy 0 (between two sets of 200 000 points on 150 m^2 it is 1.4 cm). Accuracy is measured to all of the
  true surface. Depth L1 is taken over pixels where both have a surface; the share of the other pixels is given separately.
- `nice` (NICE-SLAM): faces in a frustum, no occlusion test; the reconstruction is placed by the first frame's true pose, with which its
  authors start, not by the alignment of all poses; then ICP, point to point, 0.1 m. All frames, no far plane.
- `neural-rgbd` (Neural RGB-D, GO-Surf): faces in a frustum and unoccluded by the mesh itself, margin 3 cm, 0.01 to 10 m, every second
  frame.
- `coslam` (Co-SLAM): as neural-rgbd, and surface in a recorded frustum is kept too if a virtual view sees it unoccluded. The published
  views were placed by hand, scene by scene; here cameras at 20 free positions within 1 m of the recorded ones look in six directions.
- `eslam` (ESLAM): both meshes by frustum and occlusion against the true depth, margin 6 cm (ESLAM's truncation), all frames. ESLAM's
  re-meshing of the truth at 1 cm is left out.

In all protocols the same rule culls both meshes, and 200 000 points are sampled on each, uniformly by area. The rules test vertices;
a mesh is therefore first subdivided to edges of at most 10 cm.
"""

from dataclasses import dataclass, replace

import numpy as np

from idfslam.errors import ConfigError
from idfslam.evaluation.culling import Visibility
from idfslam.evaluation.depth_range import DepthRange


@dataclass(frozen=True)
class Protocol:
    """The rules by which a publication measures a mesh."""

    name: str
    rule: Visibility
    occlusion: bool  # whether hidden surface is removed
    occluder: str = "itself"  # the mesh that hides surface: "itself" or "truth"
    stride: int = 1  # every so many-th recorded frame is used
    virtual_positions: int = 0  # of virtual views; 0: there are none
    first_pose: bool = False  # whether the first frame's true pose places the reconstruction, not the alignment of all poses
    icp: bool = False  # whether ICP aligns the reconstruction to the truth first
    sensor_limited: bool = False  # whether the depth range is limited to the depths that the sensor read
    point_to_surface: bool = False  # distances to the surface, not to points on it; a true point must be seen itself, not only its face
    missing_is_zero: bool = True  # whether a pixel without reconstruction has depth 0 in depth L1

    def limited_to(self, sensor_range: DepthRange) -> "Protocol":
        """The same, with surface in view only where the sensor reads depth."""
        return replace(self, rule=self.rule.limited_to(sensor_range))


PROTOCOLS = {
    p.name: p
    for p in (
        Protocol("seen", Visibility(0.1, 10.0, 0.03), occlusion=True, sensor_limited=True, point_to_surface=True, missing_is_zero=False),
        Protocol("nice", Visibility(0.0, np.inf, 0.0), occlusion=False, first_pose=True, icp=True),
        Protocol("neural-rgbd", Visibility(0.01, 10.0, 0.03), occlusion=True, stride=2),
        Protocol("coslam", Visibility(0.01, 10.0, 0.03), occlusion=True, stride=2, virtual_positions=20),
        Protocol("eslam", Visibility(0.0, np.inf, 0.06), occlusion=True, occluder="truth"),
    )
}


def find_protocol(name: str) -> Protocol:
    """The protocol of this name. Raises `ConfigError`, which lists all names, if there is none."""
    if name not in PROTOCOLS:
        raise ConfigError(f"unknown protocol '{name}'; expected one of {', '.join(PROTOCOLS)}")
    return PROTOCOLS[name]
