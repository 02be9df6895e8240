"""NICE-SLAM's map: feature grids, learnt from coarse to fine with the poses of a window (Zhu et al. 2022, Sec. 3.2 to 3.4)."""

from collections.abc import Callable
from functools import partial
from typing import Any

import torch
from torch import Tensor

from idfslam.compute.adam import Adam
from idfslam.config import Config
from idfslam.geometry import se3
from idfslam.mapping.joint.joint_map import Draw, JointMap, named
from idfslam.mapping.joint.occupancy_grids import LEVELS, LearningStage, OccupancyGrids, levels_of
from idfslam.mapping.joint.occupancy_losses import RayLosses, depth_and_colour_loss, depth_errors, variance_weighted_loss
from idfslam.mapping.joint.window_poses import WindowPoses
from idfslam.mapping.occupancy_rendering import OccupancyField, RenderedRays, farthest_sample, near_surface_depths, volume_render
from idfslam.mapping.rays import Rays, join
from idfslam.mapping.training_view import TrainingView

# [m] Reach behind a reading, and around the camera, within which features are in view (NICE-SLAM's code). More: more are learnt
_BEHIND = 0.5


class GridsMap(JointMap):
    """Each update has three stages, with an Adam that starts anew: the middle level, the fine one too, then colours and poses as well."""

    field: OccupancyGrids

    def __init__(self, config: Config, device: torch.device, generator: torch.Generator) -> None:
        field = OccupancyGrids(config.occupancy_grids)
        field.load_decoders(config.occupancy_grids.weights)
        super().__init__(config, field, device, generator)
        self.refinement_rounds = config.occupancy_grids.refinement_rounds

    def render(self, field: OccupancyField, rays: Rays, *, jitter: bool) -> RenderedRays:
        return self._render(field.occupancy, rays)

    def _render(self, occupancy: Callable[[Tensor, Tensor], tuple[Tensor, Tensor]], rays: Rays) -> RenderedRays:
        c = self.config.mapper
        depths = near_surface_depths(rays.depth, farthest_sample(rays.depth), c.samples, c.importance_samples)
        return volume_render(occupancy, rays.origins, rays.directions, depths)

    def _render_coarse(self, rays: Rays) -> RenderedRays:
        """Rays through the coarse level, without samples near the surface: what it knows must not depend on the reading."""
        nothing = torch.zeros_like(rays.depth)
        depths = near_surface_depths(nothing, farthest_sample(rays.depth), self.config.mapper.samples, 0)
        return volume_render(partial(self.field.occupancy, stage=LearningStage.COARSE), rays.origins, rays.directions, depths)

    def tracking_loss(self, rays: Rays) -> RayLosses:
        c = self.config.inverse_rendering
        rendered = self._render(self.field.occupancy, rays)
        return variance_weighted_loss(rendered, rays.colour, rays.depth, c.photometric_weight, outliers=c.outliers)

    def optimise(self, draw: Draw, steps: int, poses: WindowPoses, *, first: bool = False, last: bool = False) -> dict[str, float]:
        frames, c = draw(), self.config.occupancy_grids
        count = max(1, self.config.mapper.step_pixels // len(frames))
        in_view = partial(features_in_view, TrainingView(frames[-1])) if c.in_view and not last else None
        adam = self._optimiser()
        numbers: dict[str, float] = {}
        with self.field.learning():
            self._freeze_decoders(colour=last)
            for step in range(steps):
                stage = LearningStage.COLOUR if last else self._stage(step / steps)
                self._set_rates(adam, stage, c.first_factor if first else 1.0)
                for level in ("coarse", *levels_of(stage)):
                    self.field.grid(level).gradient.zero_()
                adam.zero_grad(set_to_none=True)
                self._collect_gradients(stage)
                poses.zero_grad()
                pixels = [self.uniform_pixels(frame, count) for frame in frames]
                rays = join(self.rays_of(frames, pixels, poses, moving=stage is LearningStage.COLOUR))
                losses = self._mapping_loss(rays, stage, in_view)
                numbers = named(losses, frames[-1].index)
                self._backward(losses)
                adam.step()
                if stage is LearningStage.COLOUR:
                    poses.step()
        self._mark_used(adam)
        return numbers

    def _mapping_loss(self, rays: Rays, stage: LearningStage, in_view: Callable[[Tensor], Tensor] | None) -> RayLosses:
        """The depth loss of the coarse level and of the finest in this stage, and in the last stage that of colour (Eqs. 8-10)."""
        weight = self.config.mapper.photometric_weight if stage is LearningStage.COLOUR else 0.0
        losses = depth_and_colour_loss(
            self._render(partial(self.field.occupancy, stage=stage, learnable=in_view), rays), rays.colour, rays.depth, weight
        )
        fixed = Rays(rays.origins.detach(), rays.directions.detach(), rays.depth, rays.colour, rays.cos_incidence)
        coarse = depth_errors(self._render_coarse(fixed), rays.depth).mean()
        return RayLosses(losses.total + coarse, losses.photometric, losses.depth, losses.per_ray)

    def _stage(self, done: float) -> LearningStage:
        """The stage of a step, by the share of the steps before it."""
        c = self.config.occupancy_grids
        return LearningStage.MIDDLE if done <= c.middle_share else LearningStage.FINE if done <= c.fine_share else LearningStage.COLOUR

    def _optimiser(self) -> Adam:
        """An Adam with a group for each level, and one for the decoder of colours."""
        groups: list[dict[str, Any]] = [{"params": [self.field.grid(level).tables], "name": level} for level in LEVELS]
        groups.append({"params": list(self.field.colour_decoder.parameters()), "name": "decoder"})
        return Adam(groups, lr=0.0)

    def _set_rates(self, adam: Adam, stage: LearningStage, factor: float) -> None:
        c = self.config.occupancy_grids
        later = {"middle": c.rate, "fine": c.rate, "colour": c.rate, "decoder": c.decoder_rate}
        rates = {"coarse": c.coarse_rate} | ({"middle": c.middle_rate} if stage is LearningStage.MIDDLE else later)
        for group in adam.param_groups:
            group["lr"] = factor * rates.get(group["name"], 0.0)

    def _collect_gradients(self, stage: LearningStage) -> None:
        """Has Adam read the gradients that the backward pass adds to the buffers of the grids that take part."""
        for level in ("coarse", *levels_of(stage)):
            grid = self.field.grid(level)
            grid.tables.grad = grid.gradient

    def _freeze_decoders(self, *, colour: bool) -> None:
        """Freezes the pretrained decoders, and with `colour` that of colours too."""
        for decoder in (self.field.coarse_decoder, self.field.middle_decoder, self.field.fine_decoder):
            decoder.requires_grad_(False)
        self.field.colour_decoder.requires_grad_(not colour)

    def _mark_used(self, adam: Adam) -> None:
        """Counts the entries that this update has moved, and lets tables grow."""
        for level in LEVELS:
            grid = self.field.grid(level)
            grid.gradient.zero_()
            grid.touched.zero_()
            tables = grid.tables
            tables.grad = None
            if tables in adam.state:
                self.field.mark_used(level, (adam.state[tables]["exp_avg_sq"] > 0).any(-1)[0])


def features_in_view(view: TrainingView, points: Tensor) -> Tensor:
    """Whether points (N, 3) [m] are in a frame's view, at most half a metre behind its reading, or that near to the camera (Sec. 3.3).

    A pixel without a reading counts as the farthest one.
    """
    T_cw = se3.inverse(view.T_wk).to(points)
    in_camera = points.detach() @ T_cw[:3, :3].T + T_cw[:3, 3]
    uv, z = view.camera.project(in_camera)
    u = uv[:, 0].round().long().clamp(0, view.camera.width - 1)
    v = uv[:, 1].round().long().clamp(0, view.camera.height - 1)
    reading = view.depth[v, u]
    reading = torch.where(reading > 0, reading, view.depth.max())
    return (view.camera.inside(uv, z) & (z <= reading + _BEHIND)) | (in_camera.norm(dim=-1) < _BEHIND)
