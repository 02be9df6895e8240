"""The mapper (Sec. IV): the field learns from rays of posed frames (Eqs. 1-3), and a frame's pose is optimised against it (Eq. 4)."""

from collections.abc import Callable, Hashable, Sequence
from dataclasses import replace
from typing import Any
from weakref import WeakKeyDictionary

import torch
from torch import Tensor

from idfslam.compute.adam import Adam
from idfslam.compute.devices import repeatable, resolve_precision
from idfslam.config import FieldConfig, MapperConfig
from idfslam.geometry import se3
from idfslam.geometry.camera import Camera
from idfslam.mapping.active_sampling import CellPixels, cell_shares, draw_pixels, group_pixels, initial_cell_losses, update_cell_losses
from idfslam.mapping.compiled_field import learns_in_steps
from idfslam.mapping.field import Field, copy_of, load_field
from idfslam.mapping.loss_values import loss_values
from idfslam.mapping.losses import Losses
from idfslam.mapping.map import Map
from idfslam.mapping.objectives import Objective, RenderingObjective, SampleObjective
from idfslam.mapping.optimiser import MapOptimiser
from idfslam.mapping.rays import Rays, cast, join
from idfslam.mapping.training_view import PosedFrame, TrainingView
from idfslam.mapping.tsdf_rendering import RayMarch, render, world_rays
from idfslam.mapping.updates import BESIDE_FRAMES, MapUpdates
from idfslam.sensing.light import Light
from idfslam.storage.frame_memory import FrameMemory
from idfslam.storage.state import State

# Least numbers of stratified and of importance samples a ray in rendered views. More: sharper, slower. Chosen by hand.
_VIEW_SAMPLES, _VIEW_IMPORTANCE = 64, 16
# Width of the trunk from which bf16 is used. Below it conversions cost more than they save. More: fp32 for wider trunks too.
_BF16_WIDTH = 128
SUPERVISION: dict[str, Callable[[MapperConfig, float], Objective]] = {"rendering": RenderingObjective, "samples": SampleObjective}


class Mapper(Map):
    """Trains the field on frames with poses.

    `field` learns, and other parts query `published`. They are the same field if updates run in turns with the frames. If updates run in
    the background (`updates`), `published` is a copy that does not change while the map learns.
    """

    def __init__(
        self, config: MapperConfig, field_config: FieldConfig, device: torch.device, generator: torch.Generator, updates: MapUpdates
    ) -> None:
        self.config, self.device, self.generator, self.truncation = config, device, generator, field_config.truncation
        bf16 = resolve_precision(config.precision, device) is torch.bfloat16 and field_config.width >= _BF16_WIDTH
        self.field = Field(field_config, bf16=bf16).to(device)
        self.updates = updates
        self.published = copy_of(self.field) if updates.in_background else self.field
        self.objective: Objective = SUPERVISION[config.supervision](config, field_config.truncation)
        self.optimiser = MapOptimiser(self.field, config)
        self.light: Callable[[Any], Callable[[], Light | None]] = lambda frame: lambda: None  # tells how a frame shows the scene's colours
        self._pixels: WeakKeyDictionary[Hashable, CellPixels] = WeakKeyDictionary()  # pixels with depth of each image in memory, by cell
        self._cell_losses: FrameMemory[Tensor] = FrameMemory()  # (cells, cells) of each frame, for active sampling

    def state(self) -> State:
        """The map, its optimiser, the generator, and the losses by cell. Gradients are left out: each step starts with zero gradients."""
        self.updates.wait()
        return {
            "field": dict(self.field.state_dict()),
            "published": {} if self.published is self.field else dict(self.published.state_dict()),
            "updates": self.updates.state(),
            "optimiser": self.optimiser.state(),
            "generator": self.generator.get_state(),
            "cell_losses": self._cell_losses.state(),
        }

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        load_field(self.field, state["field"])
        if self.published is not self.field:
            load_field(self.published, state["published"])
        self.updates.restore(state["updates"])
        self.optimiser.restore(state["optimiser"])
        self.generator.set_state(state["generator"])
        self._cell_losses.restore(state["cell_losses"], lambda losses: losses.to(self.device))

    def take_over(self, field: Field) -> None:
        """Continues from another field of the same config."""
        self.field.load_state_dict(field.state_dict())
        self.optimiser.count_as_used()
        self._publish()

    def optimise_map(self, frames: Sequence[PosedFrame], iterations: int, *, double_tables: bool = False) -> dict[str, float]:
        """Optimises Eq. 3 on the rays of frames, with fixed poses, and returns the losses of the last step.

        double_tables: tables of the feature grid that have filled up are doubled first.
        """
        self.updates.wait()
        losses = self._learn(self._views(frames), iterations, double_tables=double_tables)
        self._publish()
        return losses

    def start_update(
        self,
        frames: Sequence[PosedFrame],
        iterations: int,
        *,
        anneal: float = 1.0,
        double_tables: bool = False,
        cores: float = BESIDE_FRAMES,
    ) -> dict[str, float]:
        """`optimise_map`, in the background if `updates` does so; returns the losses of the last published update.

        The frames' present poses and images are used. Each call publishes the update before it, so results do not depend on how long an
        update takes. anneal: factor on the learning rates. cores: share of them [1] for an update in the background.
        """
        self.updates.wait()
        views = self._views(frames)

        def learn() -> dict[str, float]:
            self.optimiser.anneal = anneal
            return self._learn(views, iterations, double_tables=double_tables)

        return self.updates.run(learn, self._publish, cores)

    def finish(self) -> dict[str, float]:
        """Waits for the last update, publishes it and returns its losses. Resets the learning rates."""
        losses = self.updates.losses()
        self._publish()
        self.optimiser.anneal = 1.0
        return losses

    def learnt(self) -> Field:
        """The map learnt so far, published or not."""
        self.updates.wait()
        return self.field

    @torch.no_grad()
    def _publish(self) -> None:
        """Copies the map learnt so far to `published`."""
        if self.published is not self.field:
            load_field(self.published, self.field.state_dict())

    def _learn(self, views: Sequence[TrainingView], iterations: int, *, double_tables: bool) -> dict[str, float]:
        """Optimises Eq. 3 on views; returns the losses of the last step."""
        numbers: dict[str, float] = {}
        if double_tables:
            self.optimiser.double_tables()
        with self.field.learning():
            for first in range(0, iterations, self.config.redraw):
                steps = min(self.config.redraw, iterations - first)
                each = self.config.step_pixels // len(views) if self.config.step_pixels else self.config.pixels
                pixels = [self._draw(view, each * steps, invert=False) for view in views]
                rays = join([_cast(view, uv) for view, uv in zip(views, pixels)])
                losses = self._steps(rays, steps)
                numbers = named(losses[-1], views[0].index)  # raises before losses that are not finite reach active sampling
                self._remember(views, [[uv[step::steps] for uv in pixels] for step in range(steps)], losses)
        return numbers

    def _views(self, frames: Sequence[PosedFrame]) -> list[TrainingView]:
        return [TrainingView(frame, self.light(frame)) for frame in frames]

    def _steps(self, rays: Rays, steps: int) -> list[Losses]:
        """`steps` steps of Adam, step i on every `steps`-th ray from i on."""
        if isinstance(self.objective, SampleObjective) and learns_in_steps(self.field, self.config):
            return self.objective.steps(self.field, self.optimiser, rays, steps, self.generator)
        return [self._step(rays.every(steps, step)) for step in range(steps)]

    def _step(self, rays: Rays) -> Losses:
        """One step of Adam on the map."""
        self.optimiser.zero_grad()
        losses = self.objective.learn(self.field, rays, self.generator)
        self.optimiser.step()
        return losses

    def optimise_pose(self, frame: PosedFrame) -> tuple[Tensor, dict[str, float]]:
        """Eq. 4: optimises a frame's pose against the frozen map, by Adam on an increment; more pixels are drawn where the loss is low.

        Returns T_wk (4, 4) and the losses of the last step.
        """
        self.updates.wait()
        c, view = self.config, TrainingView(frame, self.light(frame))
        xi = torch.zeros(6, device=self.device, requires_grad=True)
        adam = Adam([xi], lr=c.pose_learning_rate)
        schedule = torch.optim.lr_scheduler.StepLR(adam, c.pose_decay_every, c.pose_decay)
        start = view.T_wk.float().to(self.device)
        numbers: dict[str, float] = {}
        for _ in range(c.pose_iterations):
            adam.zero_grad()
            uv = self._draw(view, c.pixels, invert=True)
            losses = self.objective(self.field, _cast(view, uv, start @ se3.exp(xi)), self.generator)
            numbers = named(losses, view.index)
            self._remember([view], [[uv]], [losses])
            with repeatable(losses.total.device):
                losses.total.backward()
            adam.step()
            schedule.step()
        T_wk = se3.orthonormal(view.T_wk @ se3.exp(xi.detach().double().cpu()))
        return T_wk, {f"pose_{name}": value for name, value in numbers.items()}

    def renderer(self, keyframes: Sequence[PosedFrame]) -> Callable[[Camera, Tensor, Tensor], tuple[Tensor, Tensor]]:
        """A renderer of the frozen map: camera, T_wc (4, 4), pixels (B, 2) -> colour (B, 3), depth (B,) [m].

        It serves finetuning (Eqs. 1, 7) and is differentiable in the pose. Rays end behind the farthest reading of the keyframes.
        """
        c = self.config
        march = RayMarch(max(c.samples, _VIEW_SAMPLES), max(c.importance_samples, _VIEW_IMPORTANCE), self.truncation, c.sharpness)
        farthest = max(k.farthest for k in keyframes) + 2 * self.truncation

        def view(camera: Camera, T_wc: Tensor, uv: Tensor) -> tuple[Tensor, Tensor]:
            origins, directions = world_rays(T_wc, camera, uv)
            rendered = render(self.published, origins, directions, origins.new_full((len(uv),), farthest), march)
            return rendered.colour, rendered.depth

        return view

    def _draw(self, view: TrainingView, count: int, *, invert: bool) -> Tensor:
        """`count` pixels of a view in random order: more where the loss is high (Sec. IV-A), or, with `invert`, where it is low (IV-B)."""
        if view.images not in self._pixels:
            self._pixels[view.images] = group_pixels(view.depth > 0, self.config.cells)
        losses = self._losses_by_cell(view)
        if not self.config.active_sampling:
            losses = torch.ones_like(losses)
        drawn = draw_pixels(self._pixels[view.images], cell_shares(losses, invert=invert), count, self.generator)
        return drawn[torch.randperm(len(drawn), generator=self.generator, device=self.device)]

    def _losses_by_cell(self, view: TrainingView) -> Tensor:
        return self._cell_losses.of(view.frame, lambda: initial_cell_losses(self.config.cells, self.device))

    def _remember(self, views: Sequence[TrainingView], pixels: Sequence[Sequence[Tensor]], losses: Sequence[Losses]) -> None:
        """Updates the losses by cell for active sampling, from the losses of several steps and their pixels of each view."""
        if not self.config.active_sampling:
            return
        per_ray = [step.per_ray.split([len(uv) for uv in drawn]) for step, drawn in zip(losses, pixels)]
        for view, uv, of_view in zip(views, zip(*pixels), zip(*per_ray)):
            before = self._losses_by_cell(view)
            self._cell_losses[view.frame] = update_cell_losses(before, torch.cat(uv), torch.cat(of_view), *view.depth.shape)


def _cast(view: TrainingView, uv: Tensor, T_wc: Tensor | None = None) -> Rays:
    """`rays.cast` with the scene's colours."""
    rays = cast(view, uv, T_wc)
    return rays if view.light is None else replace(rays, colour=view.light.scene(rays.colour, uv, view.camera))


def named(losses: Losses, keyframe: int) -> dict[str, float]:
    """Losses as numbers by name. Raises DivergedError if one is not finite."""
    parts = {"photometric": losses.photometric, "free_space": losses.free_space, "truncation": losses.truncation, "total": losses.total}
    return loss_values(parts, f"keyframe {keyframe}", "lower --mapper.learning-rate or --mapper.gradient-clip")
