"""The parts of a run, from which its state is gathered."""

from copy import deepcopy

import torch

from idfslam.config import FAST, PAPER
from idfslam.slam import Slam
from idfslam.storage.state import Stateful, adam_dict, parts_of, plain_adam


class Part(Stateful):
    def __init__(self, **attributes: object) -> None:
        vars(self).update(attributes)


class Plain:
    """An object that is no part."""

    def __init__(self, inside: Stateful) -> None:
        self.inside = inside


def test_parts_by_their_names() -> None:
    inner, first, second = Part(), Part(), Part()
    root = Part(one=Part(inner=inner), several=[first, 3, second], number=4)
    assert list(parts_of(root)) == ["one", "several.0", "several.2", "one.inner"]
    assert parts_of(root)["one.inner"] is inner
    assert parts_of(root)["several.2"] is second


def test_each_part_is_there_once_by_the_name_nearest_to_the_root() -> None:
    shared = Part()
    root = Part(a=Part(deep=shared), b=shared, c=(shared,))
    assert {name: part is shared for name, part in parts_of(root).items()} == {"a": False, "b": True}


def test_parts_that_know_each_other() -> None:
    a, b = Part(), Part()
    vars(a)["b"], vars(b)["a"] = b, a
    root = Part(a=a)
    vars(a)["root"] = root
    assert list(parts_of(root)) == ["a", "a.b"]


def test_what_is_no_part_is_not_looked_into() -> None:
    assert parts_of(Part(plain=Plain(Part()), names={"part": Part()})) == {}


def test_a_part_without_state() -> None:
    part = Part()
    assert part.state() == {}
    part.restore({})


def test_the_parts_of_the_presets_have_states_of_their_own() -> None:
    fast, paper = parts_of(Slam(FAST)), parts_of(Slam(PAPER))
    assert {"front_end", "front_end.aligner", "front_end.registration.tracker", "recovery.relocaliser", "back_end.hooks.2"} < set(fast)
    assert {"timer", "frames", "coverage", "motion", "keyframe_selection", "mapper", "replay", "history"} < set(fast)
    assert {"back_end.updates", "back_end.updates.relearn", "back_end.updates.interval"} < set(fast)
    assert "front_end.tracker" in paper
    for parts in (fast, paper):
        assert len({id(part) for part in parts.values()}) == len(parts)


def test_an_optimiser_comes_back() -> None:
    def made() -> tuple[torch.Tensor, torch.optim.Adam]:
        weight = torch.ones(3, requires_grad=True)
        return weight, torch.optim.Adam([weight], lr=0.1)

    def step(weight: torch.Tensor, adam: torch.optim.Adam) -> None:
        adam.zero_grad()
        (weight**2).sum().backward()
        adam.step()

    weight, adam = made()
    step(weight, adam)
    again, other = made()
    other.load_state_dict(adam_dict(deepcopy(plain_adam(adam.state_dict()))))
    again.data.copy_(weight.data)
    step(weight, adam)
    step(again, other)
    assert torch.equal(weight, again)
