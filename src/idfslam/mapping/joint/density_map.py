"""iMAP's map: volume density, learnt by active sampling with the poses of a window (Sucar et al. 2021, Sec. 3.2 to 3.5)."""

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from idfslam.compute.adam import Adam
from idfslam.compute.devices import resolve_precision
from idfslam.config import Config
from idfslam.mapping.active_sampling import (
    CellPixels,
    allot,
    cell_shares,
    draw_pixels,
    group_pixels,
    initial_cell_losses,
    update_cell_losses,
)
from idfslam.mapping.joint.joint_map import Draw, JointMap, named
from idfslam.mapping.joint.occupancy_losses import RayLosses, variance_weighted_loss
from idfslam.mapping.joint.volume_density import VolumeDensity
from idfslam.mapping.joint.window_poses import WindowPoses
from idfslam.mapping.occupancy_rendering import OccupancyField, RenderedRays, farthest_sample, hierarchical_depths, volume_render
from idfslam.mapping.rays import Rays, join
from idfslam.mapping.training_view import PosedFrame
from idfslam.mapping.tsdf_rendering import stratified_depths
from idfslam.storage.frame_memory import FrameMemory
from idfslam.storage.state import State, adam_dict, plain_adam

_FREE = 0.85  # [1] of a reading up to which space is free (NICE-SLAM's code for iMAP*). More: surfaces are pushed back


class DensityMap(JointMap):
    """Each step has two stages: on evenly drawn pixels, which move map and poses, and on pixels drawn by the losses of these."""

    field: VolumeDensity

    def __init__(self, config: Config, device: torch.device, generator: torch.Generator) -> None:
        bf16 = resolve_precision(config.mapper.precision, device) is torch.bfloat16
        super().__init__(config, VolumeDensity(config.volume_density, bf16=bf16), device, generator)
        self.adam = Adam(self.field.parameters(), lr=config.mapper.learning_rate)
        self._losses: FrameMemory[float] = FrameMemory()  # mean loss of each frame when it last took part
        self._pixels: dict[tuple[int, int], CellPixels] = {}  # all pixels of an image of this size, by cell

    def state(self) -> State:
        """The same with the optimiser, and the losses of frames."""
        return super().state() | {"adam": plain_adam(self.adam.state_dict()), "losses": self._losses.state()}

    def restore(self, state: State) -> None:
        super().restore(state)
        self.adam.load_state_dict(adam_dict(state["adam"]))
        self._losses.restore(state["losses"], lambda loss: loss)

    def loss_of(self, frame: PosedFrame) -> float:
        """The mean loss of a frame when it last took part; 0 if it never did."""
        return self._losses.get(frame) or 0.0

    def render(self, field: OccupancyField, rays: Rays, *, jitter: bool) -> RenderedRays:
        c, far = self.config.mapper, farthest_sample(rays.depth)
        along, generator = (rays.origins, rays.directions), self.generator if jitter else None
        depths = hierarchical_depths(field.occupancy, *along, far, c.samples, c.importance_samples, generator)
        return volume_render(field.occupancy, *along, depths)

    def tracking_loss(self, rays: Rays) -> RayLosses:
        c = self.config.inverse_rendering
        rendered = self.render(self.field, rays, jitter=True)
        return variance_weighted_loss(rendered, rays.colour, rays.depth, c.photometric_weight, outliers=c.outliers)

    def optimise(self, draw: Draw, steps: int, poses: WindowPoses, *, first: bool = False, last: bool = False) -> dict[str, float]:
        count, numbers = self.config.mapper.pixels, dict[str, float]()
        with self.field.learning():
            for _ in range(steps):
                frames = draw()
                pixels = [self.uniform_pixels(frame, count) for frame in frames]
                numbers, per_ray = self._step(frames, pixels, poses, moving=True)
                if self.config.mapper.active_sampling:
                    active = self._active_pixels(frames, pixels, per_ray, count * len(frames))
                    numbers, _ = self._step(frames, active, poses, moving=False)
        return numbers

    def _step(
        self, frames: Sequence[PosedFrame], pixels: Sequence[Tensor], poses: WindowPoses, *, moving: bool
    ) -> tuple[dict[str, float], list[Tensor]]:
        """One step of Adam on the map, and on the poses if these move; returns the losses, and those of each frame's rays (B,)."""
        self.adam.zero_grad()
        poses.zero_grad()
        rays = join(self.rays_of(frames, pixels, poses, moving=moving))
        rendered = self.render(self.field, rays, jitter=True)
        losses = variance_weighted_loss(rendered, rays.colour, rays.depth, self.config.mapper.photometric_weight)
        if self.config.mapper.free_space_weight:
            losses = replace(losses, total=losses.total + self.config.mapper.free_space_weight * self._free_density(rays))
        numbers = named(losses, frames[-1].index)
        self._backward(losses)
        self.adam.step()
        if moving:
            poses.step()
        return numbers, list(losses.per_ray.split([len(uv) for uv in pixels]))

    def _free_density(self, rays: Rays) -> Tensor:
        """Mean density [1/m] between the camera and 85 % of the readings (NICE-SLAM's code for iMAP*)."""
        depths = stratified_depths(0.0, _FREE * rays.depth, self.config.mapper.importance_samples, self.generator)
        points = rays.origins.detach()[:, None] + rays.directions.detach()[:, None] * depths[..., None]
        density: Tensor = self.field.density(points.reshape(-1, 3))[0]
        return density.mean()

    def _active_pixels(self, frames: Sequence[PosedFrame], pixels: Sequence[Tensor], per_ray: Sequence[Tensor], count: int) -> list[Tensor]:
        """`count` pixels of several frames: each frame's share follows its mean loss, and a cell's share that of the cell (Sec. 3.5)."""
        means = torch.stack([losses.mean() for losses in per_ray])
        for frame, mean in zip(frames, means.tolist()):
            self._losses[frame] = mean
        counts = allot(means / means.sum().clamp(min=1e-12), count, self.generator).tolist()
        drawn = []
        for frame, uv, losses, number in zip(frames, pixels, per_ray, counts):
            size = frame.camera.height, frame.camera.width
            if size not in self._pixels:
                self._pixels[size] = group_pixels(torch.ones(size, dtype=torch.bool, device=self.device), self.config.mapper.cells)
            cells = update_cell_losses(0 * initial_cell_losses(self.config.mapper.cells, self.device), uv, losses, *size)
            drawn.append(draw_pixels(self._pixels[size], cell_shares(cells), number, self.generator))
        return drawn
