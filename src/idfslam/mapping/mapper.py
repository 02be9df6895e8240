"""The mapper (Sec. IV): the field learns from rays of posed frames (Eqs. 1-3), and a frame's pose is optimised against it (Eq. 4)."""

import math
from collections.abc import Callable, Hashable, Sequence
from weakref import WeakKeyDictionary

import torch
from torch import Tensor

from idfslam.compute.devices import repeatable, resolve_precision
from idfslam.config import FieldConfig, MapperConfig
from idfslam.errors import DivergedError
from idfslam.geometry import se3
from idfslam.geometry.camera import Camera
from idfslam.mapping.field import Field, copy_of, load_field
from idfslam.mapping.fused import learns_in_steps
from idfslam.mapping.losses import Losses
from idfslam.mapping.objectives import Objective, RenderingObjective, SampleObjective
from idfslam.mapping.optimiser import MapOptimiser
from idfslam.mapping.rays import Rays, cast, join
from idfslam.mapping.rendering import RayMarch, render, world_rays
from idfslam.mapping.sampling import CellPixels, cell_shares, draw_pixels, group_pixels, initial_cell_losses, update_cell_losses
from idfslam.mapping.training_view import PosedFrame, TrainingView
from idfslam.mapping.updates import MapUpdates
from idfslam.storage.frame_memory import FrameMemory
from idfslam.storage.state import State, Stateful

_VIEW_SAMPLES, _VIEW_IMPORTANCE = 64, 16  # least samples a ray in rendered views, whose depth is not measured; more: sharper, slower
_BF16_WIDTH = 128  # of the trunk, from which bf16 is faster than fp32; below it conversions cost more than they save
SUPERVISION: dict[str, Callable[[MapperConfig, float], Objective]] = {"rendering": RenderingObjective, "samples": SampleObjective}


class Mapper(Stateful):
    """Owns the field and its optimiser; is given frames with poses.

    `field` is what learns, `published` what others look at: the same field where updates run in turns with the frames, and a copy that
    stands still while the map learns where they run in the background (`updates`).
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
        self._pixels: WeakKeyDictionary[Hashable, CellPixels] = WeakKeyDictionary()  # with depth, by cell; of the images in memory
        self._cell_losses: FrameMemory[Tensor] = FrameMemory()  # (cells, cells) each, for active sampling

    def state(self) -> State:
        """The map, its optimiser and the generator. Gradients are no part of it: each step begins with none."""
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
        """Goes on from another field of the same config."""
        self.field.load_state_dict(field.state_dict())
        self.optimiser.count_as_used()
        self._publish()

    def optimise_map(self, frames: Sequence[PosedFrame], iterations: int, *, grow: bool = False) -> dict[str, float]:
        """Eq. 3: steps on the rays of all given frames, poses fixed, before it returns; the last step's losses.

        grow: before, tables that have filled up are doubled; the map stays the same function.
        """
        self.updates.wait()
        losses = self._learn(_views(frames), iterations, grow=grow)
        self._publish()
        return losses

    def start_update(self, frames: Sequence[PosedFrame], iterations: int, *, anneal: float = 1.0, grow: bool = False) -> dict[str, float]:
        """`optimise_map`, in the background where `updates` says so; returns the losses of the last update that was published.

        The frames' poses and images are those of now. In the background, what is published is the same at the same calls on every
        machine, however long learning takes: results do not depend on it. anneal: factor on the learning rates.
        """
        self.updates.wait()
        views = _views(frames)

        def learn() -> dict[str, float]:
            self.optimiser.anneal = anneal
            return self._learn(views, iterations, grow=grow)

        return self.updates.run(learn, self._publish)

    def finish(self) -> dict[str, float]:
        """Waits for the last update and publishes it; its losses. Learning rates are full again."""
        losses = self.updates.losses()
        self._publish()
        self.optimiser.anneal = 1.0
        return losses

    def learnt(self) -> Field:
        """The map as it has been learnt so far, published or not."""
        self.updates.wait()
        return self.field

    @torch.no_grad()
    def _publish(self) -> None:
        """From now on `published` is the map as it has been learnt so far."""
        if self.published is not self.field:
            load_field(self.published, self.field.state_dict())

    def _learn(self, views: Sequence[TrainingView], iterations: int, *, grow: bool) -> dict[str, float]:
        """Eq. 3 on views as they are."""
        numbers: dict[str, float] = {}
        if grow:
            self.optimiser.grow()
        with self.optimiser.learning():
            for first in range(0, iterations, self.config.redraw):
                steps = min(self.config.redraw, iterations - first)
                each = self.config.step_pixels // len(views) if self.config.step_pixels else self.config.pixels
                pixels = [self._draw(view, each * steps, invert=False) for view in views]
                rays = join([cast(view, uv) for view, uv in zip(views, pixels)])
                losses = self._steps(rays, steps)
                numbers = named(losses[-1], views[0].index)  # before losses that are not finite decide on pixels
                self._remember(views, [[uv[step::steps] for uv in pixels] for step in range(steps)], losses)
        return numbers

    def _steps(self, rays: Rays, steps: int) -> list[Losses]:
        """Steps of Adam, each on every `steps`-th ray."""
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
        """Eq. 4: the frame's pose T_wk (4, 4) against the frozen map, by Adam on an increment; pixels where the loss is low.

        Also the losses of the last step.
        """
        self.updates.wait()
        c, view = self.config, TrainingView(frame)
        xi = torch.zeros(6, device=self.device, requires_grad=True)
        adam = torch.optim.Adam([xi], lr=c.pose_learning_rate)
        schedule = torch.optim.lr_scheduler.StepLR(adam, c.pose_decay_every, c.pose_decay)
        start = view.T_wk.float().to(self.device)
        numbers: dict[str, float] = {}
        for _ in range(c.pose_iterations):
            adam.zero_grad()
            uv = self._draw(view, c.pixels, invert=True)
            losses = self.objective(self.field, cast(view, uv, start @ se3.exp(xi)), self.generator)
            numbers = named(losses, view.index)
            self._remember([view], [[uv]], [losses])
            with repeatable(losses.total.device):
                losses.total.backward()
            adam.step()
            schedule.step()
        T_wk = se3.orthonormal(view.T_wk @ se3.exp(xi.detach().double().cpu()))
        return T_wk, {f"pose_{name}": value for name, value in numbers.items()}

    def renderer(self, keyframes: Sequence[PosedFrame]) -> Callable[[Camera, Tensor, Tensor], tuple[Tensor, Tensor]]:
        """The frozen map as a camera sees it: camera, T_wc (4, 4), pixels (B, 2) -> colour (B, 3), depth (B,) [m].

        For finetuning (Eqs. 1, 7): differentiable in the pose. Rays end behind the farthest reading of the keyframes.
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
        """`count` pixels of a view in random order (Sec. IV-A: more where the loss is high; IV-B: where it is low)."""
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
        """How the loss is spread over each image, for active sampling: of several steps the losses, and the pixels of each view."""
        if not self.config.active_sampling:
            return
        per_ray = [step.per_ray.split([len(uv) for uv in drawn]) for step, drawn in zip(losses, pixels)]
        for view, uv, of_view in zip(views, zip(*pixels), zip(*per_ray)):
            before = self._losses_by_cell(view)
            self._cell_losses[view.frame] = update_cell_losses(before, torch.cat(uv), torch.cat(of_view), *view.depth.shape)


def _views(frames: Sequence[PosedFrame]) -> list[TrainingView]:
    return [TrainingView(frame) for frame in frames]


def named(losses: Losses, keyframe: int) -> dict[str, float]:
    """Losses as plain numbers. Raises DivergedError if one is not finite."""
    parts = {"photometric": losses.photometric, "free_space": losses.free_space, "truncation": losses.truncation, "total": losses.total}
    numbers = dict(zip(parts, torch.stack(list(parts.values())).tolist()))
    for name, value in numbers.items():
        if not math.isfinite(value):
            raise DivergedError(f"keyframe {keyframe}: the {name} loss is {value}; lower --mapper.learning-rate or --mapper.gradient-clip")
    return numbers
