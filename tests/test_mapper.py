"""The mapper on a corner of three walls: gradients of the pose, Eqs. 3 and 4, and what happens when a loss is not finite."""

import math
from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from idfslam.config import FieldConfig, MapperConfig
from idfslam.errors import DivergedError
from idfslam.frame import Frame
from idfslam.geometry import se3
from idfslam.geometry.camera import Camera
from idfslam.graph.keyframe import Keyframe
from idfslam.mapping.field import Field
from idfslam.mapping.mapper import Mapper
from idfslam.mapping.objectives import RenderingObjective
from idfslam.mapping.rays import cast
from idfslam.mapping.updates import InBackground, InTurns, MapUpdates

CAMERA = Camera(64, 48, 50.0, 50.0, 31.5, 23.5)
WALLS = torch.tensor([0.8, 0.5, 2.0], dtype=torch.float64)  # x, y, z of the three walls [m]
FIELD = FieldConfig(
    encoding="positional", truncation=0.1, position_frequencies=6, direction_frequencies=2, layers=3, width=64, skip=2, colour_width=32
)
CONFIG = MapperConfig(
    supervision="rendering",
    pixels=200,
    step_pixels=256,
    samples=16,
    importance_samples=8,
    photometric_weight=0.1,
    free_space_weight=10.0,
    truncation_weight=6000.0,
    redraw=1,
    learning_rate=0.005,
    gradient_clip=1.0,
    warm_up=20,
    pose_optimisation=True,
    precision="fp32",
)


def view(T_wc: Tensor, index: int = 0) -> Keyframe:
    """The corner seen from T_wc: a ray ends at the first wall it meets."""
    directions = CAMERA.rays(CAMERA.pixels()).double() @ T_wc[:3, :3].T
    reach = torch.where(directions > 1e-6, (WALLS - T_wc[:3, 3]) / directions.clamp(min=1e-6), torch.inf)
    depth = reach.amin(-1)
    points = T_wc[:3, 3] + directions * depth[..., None]
    colour = 0.5 + 0.4 * torch.sin(6 * points + torch.tensor([0.0, 1.0, 2.0]))
    frame = Frame(index, 0.0, colour.float().numpy(), depth.float().numpy(), CAMERA)
    return Keyframe(frame, T_wc, torch.from_numpy(frame.depth), torch.from_numpy(frame.colour))


def pose(*increment: float) -> Tensor:
    return se3.exp(torch.tensor(increment, dtype=torch.float64))


def mapper(config: MapperConfig = CONFIG, updates: MapUpdates | None = None) -> Mapper:
    torch.manual_seed(0)
    return Mapper(config, FIELD, torch.device("cpu"), torch.Generator().manual_seed(0), updates or InTurns())


@pytest.fixture(scope="module")
def taught() -> Mapper:
    """A map that has learnt the corner from the identity."""
    learner = mapper(replace(CONFIG, pose_iterations=60))
    learner.optimise_map([view(torch.eye(4, dtype=torch.float64))], 400)
    return learner


def test_the_poses_gradient_against_finite_differences() -> None:
    torch.manual_seed(1)
    field = Field(FIELD).double()
    objective = RenderingObjective(replace(CONFIG, importance_samples=0), FIELD.truncation)  # importance samples move without gradient
    keyframe = view(torch.eye(4, dtype=torch.float64))
    keyframe = Keyframe(keyframe.frame, keyframe.T_wk, keyframe.depth.double(), keyframe.colour.double())
    uv = torch.randint(0, 48, (30, 2), generator=torch.Generator().manual_seed(2))

    def loss(xi: Tensor) -> Tensor:
        rays = cast(keyframe, uv, pose(0.1, 0, 0.05, 0.02, 0.1, 0) @ se3.exp(xi))
        return objective(field, rays, torch.Generator().manual_seed(3)).total

    xi = torch.zeros(6, dtype=torch.float64, requires_grad=True)
    (gradient,) = torch.autograd.grad(loss(xi), xi)
    step = 1e-6 * torch.eye(6, dtype=torch.float64)
    differences = torch.stack([(loss(h) - loss(-h)) / 2e-6 for h in step]).detach()
    assert float(gradient.abs().min()) > 1e-3
    torch.testing.assert_close(gradient, differences, rtol=1e-4, atol=1e-4)


def test_the_map_step_lowers_every_loss() -> None:
    learner, keyframe = mapper(), view(torch.eye(4, dtype=torch.float64))
    before = learner.optimise_map([keyframe], 1)
    after = learner.optimise_map([keyframe], 150)
    assert after["total"] < before["total"] / 4
    assert after["truncation"] < before["truncation"] / 4
    assert after["free_space"] < before["free_space"] / 2


def test_a_displaced_pose_comes_back(taught: Mapper) -> None:
    # 5.4 cm and 1.7 degrees away; Adam at 0.005 could walk 5 mm a step, 8.6 cm in all with its decay of 0.7 every 10 steps.
    T_start = pose(0.03, -0.02, 0.04, 0.015, -0.02, 0.015)
    keyframe = view(torch.eye(4, dtype=torch.float64), index=7)
    keyframe.T_wk = T_start
    weights = {name: value.clone() for name, value in taught.field.state_dict().items()}
    T_wk, losses = taught.optimise_pose(keyframe)
    assert float(T_wk[:3, 3].norm()) < 0.025 < float(T_start[:3, 3].norm()) / 2
    assert math.degrees(float(se3.angle(T_wk))) < 0.6
    assert T_wk.dtype == torch.float64
    assert keyframe.T_wk is T_start  # whoever asked moves it
    assert set(losses) == {"pose_photometric", "pose_free_space", "pose_truncation", "pose_total"}
    assert all(torch.equal(value, weights[name]) for name, value in taught.field.state_dict().items())  # the map is frozen


def test_the_map_is_rendered_from_a_pose(taught: Mapper) -> None:
    keyframe = view(torch.eye(4, dtype=torch.float64))
    uv = torch.tensor([[31, 23], [10, 12], [50, 15]])
    T_wc = torch.eye(4, requires_grad=True)
    colour, depth = taught.renderer([keyframe])(keyframe.camera, T_wc, uv)
    torch.testing.assert_close(depth, keyframe.depth[uv[:, 1], uv[:, 0]], atol=0.1, rtol=0)
    assert colour.shape == (3, 3)
    depth.sum().backward()
    assert float(T_wc.grad.norm()) > 0


def test_a_loss_that_is_not_finite_names_keyframe_and_loss() -> None:
    learner, keyframe = mapper(), view(torch.eye(4, dtype=torch.float64), index=31)
    with torch.no_grad():
        learner.field.sdf_head.bias.fill_(np.nan)
    with pytest.raises(DivergedError, match=r"keyframe 31: the \w+ loss is nan; lower --mapper.learning-rate"):
        learner.optimise_map([keyframe], 5)
    another = view(pose(0.1, 0, 0, 0, 0, 0), index=32)
    T_wk = another.T_wk.clone()
    with pytest.raises(DivergedError, match="keyframe 32"):
        learner.optimise_pose(another)
    assert torch.equal(another.T_wk, T_wk)


def test_without_iterations_there_are_no_losses(taught: Mapper) -> None:
    assert taught.optimise_map([view(torch.eye(4, dtype=torch.float64))], 0) == {}


def in_background() -> tuple[Mapper, list[Keyframe]]:
    """A map that learns in the background, after its first frame."""
    learner = mapper(updates=InBackground())
    keyframes = [view(torch.eye(4, dtype=torch.float64)), view(pose(0.1, 0, 0, 0, 0, 0), index=1)]
    learner.optimise_map(keyframes[:1], 5)
    return learner, keyframes


def weights(field: Field) -> list[Tensor]:
    return [value.clone() for value in field.state_dict().values()]


def test_an_update_in_the_background_is_published_at_the_next() -> None:
    learner, keyframes = in_background()
    before = weights(learner.published)
    assert learner.start_update(keyframes, 5) == {}
    keyframes[1].T_wk = pose(9, 9, 9, 0, 0, 0)  # too late to be seen
    learnt = weights(learner.learnt())
    assert all(torch.equal(a, b) for a, b in zip(before, weights(learner.published)))
    losses = learner.start_update(keyframes[:1], 5)
    assert losses["total"] > 0
    assert all(torch.equal(a, b) for a, b in zip(learnt, weights(learner.published)))
    assert not all(torch.equal(a, b) for a, b in zip(before, learnt))
    assert len(learner.updates.times()) >= 1
    learner.finish()
    # The same in turns
    turns, keyframes = in_background()
    turns.optimise_map(keyframes, 5)
    turns.optimise_map(keyframes[:1], 5)
    assert all(torch.equal(a, b) for a, b in zip(weights(learner.published), weights(turns.published)))


def test_an_error_in_the_background_is_raised_at_the_next_update() -> None:
    learner, keyframes = in_background()
    with torch.no_grad():
        learner.field.sdf_head.bias.fill_(np.nan)
    learner.start_update(keyframes, 5)
    with pytest.raises(DivergedError, match="keyframe 0"):
        learner.start_update(keyframes, 5)


def test_the_state_of_a_mapper_that_is_learning() -> None:
    learner, keyframes = in_background()
    learner.start_update(keyframes, 5)
    other, again = in_background()
    other.restore(deepcopy(learner.state()))
    assert set(other.state()["cell_losses"]) == {"0", "1"}
    assert all(torch.equal(a, b) for a, b in zip(weights(learner.published), weights(other.published)))
    assert learner.start_update(keyframes, 5) == other.start_update(again, 5) != {}
    for mine, its in ((learner.published, other.published), (learner.learnt(), other.learnt())):
        assert all(torch.equal(a, b) for a, b in zip(weights(mine), weights(its)))
