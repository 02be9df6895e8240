"""A map that is optimised together with the poses of a window of frames, and that gives a frame's pose by inverse rendering.

iMAP and NICE-SLAM do both (Sec. 3.3 of each paper). How they sample, weigh and step differs: `density_map.py`, `grids_map.py`.
"""

from abc import abstractmethod
from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor

from idfslam.compute.devices import repeatable
from idfslam.config import Config
from idfslam.mapping.field import copy_of, load_field
from idfslam.mapping.joint.occupancy_losses import RayLosses
from idfslam.mapping.joint.window_poses import WindowPoses
from idfslam.mapping.loss_values import loss_values
from idfslam.mapping.map import Map
from idfslam.mapping.occupancy_rendering import OccupancyField, RenderedRays
from idfslam.mapping.rays import Rays, cast
from idfslam.mapping.training_view import PosedFrame, TrainingView
from idfslam.storage.state import State

Draw = Callable[[], Sequence[PosedFrame]]
"""Gives the frames of a step, the current one last."""


class JointMap(Map):
    """A field, learnt from rendered rays; poses of frames follow from the same losses."""

    refinement_rounds = 0  # updates after the last frame

    def __init__(self, config: Config, field: OccupancyField, device: torch.device, generator: torch.Generator) -> None:
        self.config, self.device, self.generator = config, device, generator
        self.field = self.published = field.to(device).requires_grad_(False)
        self.snapshot: OccupancyField | None = None  # the field at the last keyframe (`lock`)
        self.light = lambda frame: lambda: None

    def state(self) -> State:
        """The field, its snapshot, and the generator."""
        snapshot = {} if self.snapshot is None else dict(self.snapshot.state_dict())
        return {"field": dict(self.field.state_dict()), "snapshot": snapshot, "generator": self.generator.get_state()}

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        load_field(self.field, state["field"])
        if state["snapshot"]:
            self.snapshot = copy_of(self.field)
            load_field(self.snapshot, state["snapshot"])
        self.generator.set_state(state["generator"])

    def learnt(self) -> OccupancyField:
        return self.field

    def take_over(self, field: Any) -> None:
        load_field(self.field, field.state_dict())

    def lock(self) -> None:
        """Keeps a copy of the field, with which later frames are compared (iMAP, Sec. 3.4)."""
        self.snapshot = copy_of(self.field)

    def loss_of(self, frame: PosedFrame) -> float:
        """The mean loss of a frame when it last took part in an update; 1 if the map does not remember it."""
        return 1.0

    @abstractmethod
    def render(self, field: OccupancyField, rays: Rays, *, jitter: bool) -> RenderedRays:
        """Renders rays of one or several frames. jitter: samples are placed at random in their strata, where the map does so at all."""

    @abstractmethod
    def tracking_loss(self, rays: Rays) -> RayLosses:
        """The loss of rays whose pose is looked for."""

    @abstractmethod
    def optimise(self, draw: Draw, steps: int, poses: WindowPoses, *, first: bool = False, last: bool = False) -> dict[str, float]:
        """`steps` steps on the windows that `draw` gives, which move `poses` too; returns the losses of the last step.

        first: on the first frame, whose pose is the world. last: after the last frame.
        """

    def track(self, view: PosedFrame) -> tuple[Tensor, dict[str, float]]:
        """The pose T_wc (4, 4) of a frame by Adam against the frozen map, from its predicted one, and the losses of its best step."""
        c = self.config.inverse_rendering
        poses = WindowPoses(c.learning_rate, self.device, lambda frame: True)
        best, losses_of_best = view.T_wk, dict[str, float]()
        for _ in range(c.iterations):
            poses.zero_grad()
            T_wc = poses.of(view)
            before = poses.poses()[0][1]
            losses = self.tracking_loss(cast(TrainingView(view), self.uniform_pixels(view, c.pixels, c.border), T_wc))
            numbers = named(losses, view.index)
            if not losses_of_best or numbers["total"] < losses_of_best["total"]:
                best, losses_of_best = before, numbers
            self._backward(losses)
            poses.step()
        return best, {f"pose_{name}": value for name, value in losses_of_best.items()}

    @torch.no_grad()
    def explained(self, view: PosedFrame) -> float:
        """Share of a frame's pixels with a reading whose depth the snapshot explains (iMAP, Sec. 3.4); 1 before there is one."""
        if self.snapshot is None:
            return 1.0
        rays = cast(TrainingView(view), self.uniform_pixels(view, self.config.mapper.pixels))
        rendered = self.render(self.snapshot, rays, jitter=False)
        return explained_share(rendered.depth, rays.depth, self.config.keyframes.explained_error)

    def uniform_pixels(self, view: PosedFrame, count: int, border: int = 0) -> Tensor:
        """`count` random pixels (count, 2) int64 (u, v) of a frame, `border` pixels from its edges, or a quarter of its shorter side."""
        size = torch.tensor([view.camera.width, view.camera.height], device=self.device)
        border = min(border, int(size.min()) // 4)
        drawn = torch.rand(count, 2, generator=self.generator, device=self.device)
        return (border + drawn * (size - 2 * border)).long()

    def rays_of(self, frames: Sequence[PosedFrame], pixels: Sequence[Tensor], poses: WindowPoses, *, moving: bool) -> list[Rays]:
        """Rays through pixels (B, 2) of each frame; differentiable in their poses if these move."""
        return [cast(TrainingView(frame), uv, poses.of(frame, moving=moving)) for frame, uv in zip(frames, pixels)]

    def _backward(self, losses: RayLosses) -> None:
        with repeatable(self.device):
            losses.total.backward()


def explained_share(rendered: Tensor, measured: Tensor, error: float) -> float:
    """Share of readings (B,) [m] that rendered depths (B,) [m] differ from by less than `error` times the reading; 1 without a reading."""
    seen = measured > 0
    if not bool(seen.any()):
        return 1.0
    return float((((rendered - measured).abs() < error * measured)[seen]).float().mean())


def named(losses: RayLosses, frame: int) -> dict[str, float]:
    """Losses as numbers by name. Raises DivergedError if one is not finite."""
    parts = {"photometric": losses.photometric, "depth": losses.depth, "total": losses.total}
    return loss_values(parts, f"frame {frame}", "lower the learning rates of the preset")
