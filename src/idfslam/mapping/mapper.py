"""The mapper: the map and the keyframe poses, optimised in turns (Sec. IV)."""

import math
from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from idfslam.compute.devices import repeatable, resolve_precision
from idfslam.config import FieldConfig, MapperConfig
from idfslam.errors import DivergedError
from idfslam.geometry import se3
from idfslam.graph.keyframe import Keyframe
from idfslam.mapping.background import Beside
from idfslam.mapping.field import Field, copy_of, load_field
from idfslam.mapping.fused import learns_in_steps
from idfslam.mapping.losses import Losses
from idfslam.mapping.objectives import Objective, RenderingObjective, SampleObjective
from idfslam.mapping.optimiser import MapOptimiser
from idfslam.mapping.rays import Rays, cast, join
from idfslam.mapping.rendering import RayMarch, render, world_rays
from idfslam.mapping.sampling import cell_shares, draw_pixels, group_pixels, initial_cell_losses, update_cell_losses
from idfslam.storage.state import State

_VIEW_SAMPLES, _VIEW_IMPORTANCE = 64, 16  # least samples a ray for a view: rays there know nothing of the depth
SUPERVISION: dict[str, Callable[[MapperConfig, float], Objective]] = {"rendering": RenderingObjective, "samples": SampleObjective}


class MapView:
    """A keyframe as it is now: learning beside other work must not see its pose move, nor its images put away."""

    def __init__(self, keyframe: Keyframe) -> None:
        self.keyframe, self.T_wk, self.camera = keyframe, keyframe.T_wk, keyframe.camera
        self.depth, self.colour = keyframe.depth, keyframe.colour


class Mapper:
    """Owns the field and its optimiser; is handed keyframes, and moves their poses.

    `field` is what learns, `published` what others look at: a copy that stands still while the map learns beside them.
    """

    def __init__(self, config: MapperConfig, field_config: FieldConfig, device: torch.device, generator: torch.Generator) -> None:
        self.config, self.device, self.generator, self.truncation = config, device, generator, field_config.truncation
        bf16 = resolve_precision(config.precision, device) is torch.bfloat16 and field_config.width >= 128
        self.field = Field(field_config, bf16=bf16).to(device)
        self.published = copy_of(self.field) if config.background else self.field
        self.objective: Objective = SUPERVISION[config.supervision](config, field_config.truncation)
        self.optimiser = MapOptimiser(self.field, config)
        self.beside = Beside()

    def state(self) -> State:
        """The map, its optimiser and the generator. Gradients are no part of it: each step begins with none."""
        self.beside.wait()
        published = {"published": dict(self.published.state_dict()), "beside": self.beside.state()} if self.config.background else {}
        own = {"field": dict(self.field.state_dict()), "optimiser": self.optimiser.state(), "generator": self.generator.get_state()}
        return own | published

    def restore(self, state: State) -> None:
        """What `state` told."""
        load_field(self.field, state["field"])
        if self.config.background:
            load_field(self.published, state["published"])
            self.beside.restore(state["beside"])
        self.optimiser.restore(state["optimiser"])
        self.generator.set_state(state["generator"])

    def take_over(self, field: Field) -> None:
        """Go on from another field of the same config."""
        self.field.load_state_dict(field.state_dict())
        self.optimiser.count_as_used()
        self.publish()

    def initialise(self, keyframes: Sequence[Keyframe]) -> dict[str, float]:
        """Teach the map the first keyframe of a piece, beside others."""
        return self.optimise_map(keyframes, self.config.first_iterations)

    def optimise_map(self, keyframes: Sequence[Keyframe], iterations: int, *, grow: bool = False) -> dict[str, float]:
        """Eq. 3: steps on the rays of all given keyframes, poses fixed; the last step's losses.

        grow: before, tables that have filled up are doubled; the map stays the same function.
        """
        self.beside.wait()
        losses = self._learn(_views(keyframes), iterations, grow=grow)
        self.publish()
        return losses

    def start(self, keyframes: Sequence[Keyframe], iterations: int, *, anneal: float = 1.0, grow: bool = False) -> dict[str, float]:
        """`optimise_map` beside what the caller does next; returns the losses of the one before, whose map is published now.

        The keyframes' poses and images are those of now. What is published is so at the same calls on every machine, however long learning
        takes: results do not depend on it.
        """
        if not self.config.background:
            self.optimiser.anneal = anneal
            return self.optimise_map(keyframes, iterations, grow=grow)
        losses = self.finish()
        self.optimiser.anneal = anneal
        views = _views(keyframes)
        self.beside.start(lambda: self._learn(views, iterations, grow=grow))
        return losses

    def finish(self) -> dict[str, float]:
        """Waits for what was started, and publishes it; its losses."""
        losses = self.beside.losses()
        self.publish()
        return losses

    def learnt(self) -> Field:
        """The map as it has been learnt so far, published or not."""
        self.beside.wait()
        return self.field

    @torch.no_grad()
    def publish(self) -> None:
        """From now on `published` is the map as it has been learnt so far."""
        if self.published is not self.field:
            load_field(self.published, self.field.state_dict())

    def _learn(self, views: Sequence[MapView], iterations: int, *, grow: bool) -> dict[str, float]:
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
                numbers = named(losses[-1], views[0].keyframe.index)  # before losses that are not finite decide on pixels
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

    def optimise_pose(self, keyframe: Keyframe) -> dict[str, float]:
        """Eq. 4: the keyframe's pose against the frozen map, by Adam on an increment; pixels where the loss is low."""
        self.beside.wait()
        c, view = self.config, MapView(keyframe)
        xi = torch.zeros(6, device=self.device, requires_grad=True)
        adam = torch.optim.Adam([xi], lr=c.pose_learning_rate)
        schedule = torch.optim.lr_scheduler.StepLR(adam, c.pose_decay_every, c.pose_decay)
        start = keyframe.T_wk.float().to(self.device)
        numbers: dict[str, float] = {}
        for _ in range(c.pose_iterations):
            adam.zero_grad()
            uv = self._draw(view, c.pixels, invert=True)
            losses = self.objective(self.field, cast(view, uv, start @ se3.exp(xi)), self.generator)
            numbers = named(losses, keyframe.index)
            self._remember([view], [[uv]], [losses])
            with repeatable(losses.total.device):
                losses.total.backward()
            adam.step()
            schedule.step()
        keyframe.T_wk = se3.orthonormal(keyframe.T_wk @ se3.exp(xi.detach().double().cpu()))
        return {f"pose_{name}": value for name, value in numbers.items()}

    def renderer(self, keyframes: Sequence[Keyframe]) -> Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]:
        """The frozen map as the keyframes' camera sees it: T_wc (4, 4), pixels (B, 2) -> colour (B, 3), depth (B,) [m].

        For finetuning (Eqs. 1, 7): differentiable in the pose. Rays end behind the farthest reading of the keyframes.
        """
        c, camera = self.config, keyframes[0].camera
        march = RayMarch(max(c.samples, _VIEW_SAMPLES), max(c.importance_samples, _VIEW_IMPORTANCE), self.truncation, c.sharpness)
        farthest = max(k.farthest for k in keyframes) + 2 * self.truncation

        def view(T_wc: Tensor, uv: Tensor) -> tuple[Tensor, Tensor]:
            origins, directions = world_rays(T_wc, camera, uv)
            rendered = render(self.published, origins, directions, origins.new_full((len(uv),), farthest), march)
            return rendered.colour, rendered.depth

        return view

    def _draw(self, view: MapView, count: int, *, invert: bool) -> Tensor:
        """`count` pixels of a view in random order (Sec. IV-A: more where the loss is high; IV-B: where it is low)."""
        keyframe, cells = view.keyframe, self.config.cells
        if keyframe.pixels is None:
            keyframe.pixels = group_pixels(view.depth > 0, cells)
        if keyframe.cell_losses is None:
            keyframe.cell_losses = initial_cell_losses(cells, self.device)
        losses = keyframe.cell_losses if self.config.active_sampling else torch.ones_like(keyframe.cell_losses)
        drawn = draw_pixels(keyframe.pixels, cell_shares(losses, invert=invert), count, self.generator)
        return drawn[torch.randperm(len(drawn), generator=self.generator, device=self.device)]

    def _remember(self, views: Sequence[MapView], pixels: Sequence[Sequence[Tensor]], losses: Sequence[Losses]) -> None:
        """How the loss is spread over each image, for active sampling: of several steps the losses, and the pixels of each view."""
        if not self.config.active_sampling:
            return
        per_ray = [step.per_ray.split([len(uv) for uv in drawn]) for step, drawn in zip(losses, pixels)]
        for view, uv, found in zip(views, zip(*pixels), zip(*per_ray)):
            known = view.keyframe.cell_losses
            assert known is not None
            view.keyframe.cell_losses = update_cell_losses(known, torch.cat(uv), torch.cat(found), *view.depth.shape)


def _views(keyframes: Sequence[Keyframe]) -> list[MapView]:
    """What the map learns of keyframes: where they are now."""
    for keyframe in keyframes:
        keyframe.unlearnt = max(0, keyframe.unlearnt - 1)
    return [MapView(k) for k in keyframes]


def named(losses: Losses, keyframe: int) -> dict[str, float]:
    """Losses as plain numbers. Raises DivergedError if one is not finite."""
    parts = {"photometric": losses.photometric, "free_space": losses.free_space, "truncation": losses.truncation, "total": losses.total}
    numbers = dict(zip(parts, torch.stack(list(parts.values())).tolist()))
    for name, value in numbers.items():
        if not math.isfinite(value):
            raise DivergedError(f"keyframe {keyframe}: the {name} loss is {value}; lower --mapper.learning-rate or --mapper.gradient-clip")
    return numbers
