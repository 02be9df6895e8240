"""Three walls that meet in a corner, seen by a camera with exact depth, and maps that have learnt them."""

from dataclasses import replace

import torch
from torch import Tensor

from idfslam.alignment.aligner import MapAligner
from idfslam.config import AlignmentConfig, FieldConfig, MapperConfig
from idfslam.frame import Frame
from idfslam.geometry import se3
from idfslam.geometry.camera import Camera
from idfslam.graph.keyframe import Keyframe
from idfslam.mapping.compiled_field import distance_query
from idfslam.mapping.mapper import Mapper
from idfslam.mapping.updates import InTurns

CAMERA = Camera(160, 120, 120.0, 120.0, 79.5, 59.5)
CORNER = torch.tensor([0.8, 0.6, 1.8], dtype=torch.float64)  # x, y, z of its walls [m]
WALL = torch.tensor([9.0, 9.0, 1.5], dtype=torch.float64)  # two of the walls out of sight
CONFIG = AlignmentConfig(points=3000, image_height=120, image_levels=3, landmarks=1500)
EYE = torch.eye(4, dtype=torch.float64)


def pose(*increment: float) -> Tensor:
    return se3.exp(torch.tensor(increment, dtype=torch.float64))


def view(walls: Tensor, T_wc: Tensor, *, index: int = 0, paint: float = 0.2) -> Keyframe:
    """Three walls seen from T_wc: a ray ends at the first that it meets."""
    directions = CAMERA.rays(CAMERA.pixels()).double() @ T_wc[:3, :3].T
    reach = torch.where(directions > 1e-6, (walls - T_wc[:3, 3]) / directions.clamp(min=1e-6), torch.inf)
    depth = reach.amin(-1)
    points = T_wc[:3, 3] + directions * depth[..., None]
    colour = 0.5 + paint * torch.sin(9 * points) + paint * torch.sin(21 * points[..., [1, 2, 0]])
    frame = Frame(index, 0.0, colour.float().numpy(), depth.float().numpy(), CAMERA)
    return Keyframe(frame, T_wc, torch.from_numpy(frame.depth), torch.from_numpy(frame.colour))


def without_depth(keyframe: Keyframe) -> Keyframe:
    return with_depth(keyframe, torch.zeros_like(keyframe.depth))


def with_depth(keyframe: Keyframe, depth: Tensor) -> Keyframe:
    """The same view with another depth (H, W) [m]."""
    return Keyframe(replace(keyframe.frame, depth=depth.numpy()), keyframe.T_wk, depth, keyframe.colour)


def taught(walls: Tensor) -> Mapper:
    """A map that has learnt the walls from three views."""
    torch.manual_seed(0)
    learner = Mapper(MapperConfig(), FieldConfig(table_log2=14), torch.device("cpu"), torch.Generator().manual_seed(0), InTurns())
    views = [view(walls, EYE), view(walls, pose(0.1, 0, 0, 0, 0.05, 0)), view(walls, pose(-0.1, 0.05, 0.1, 0.03, -0.05, 0))]
    learner.optimise_map(views, 150)
    return learner


def aligner(learner: Mapper, config: AlignmentConfig = CONFIG) -> MapAligner:
    return MapAligner(config, distance_query(learner.field), learner.field.config.truncation, torch.Generator().manual_seed(0))


def error(T: Tensor, truth: Tensor) -> tuple[float, float]:
    """[m], [degrees]"""
    difference = se3.inverse(truth) @ T
    return float(difference[:3, 3].norm()), float(torch.rad2deg(se3.angle(difference)))
