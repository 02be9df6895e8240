"""The state of a part as plain values, so that a run can be saved and resumed.

`state()` holds all that the part's next answers depend on and its config does not: tensors, which may share memory with the part, and what
JSON can hold, nested in lists and dicts with words for keys. `restore(state)` puts it into a part made with the same config, whose next
answers are then the same to the last bit. What can be worked out again to the last bit (features, image pyramids) is left out.
"""

from collections.abc import Iterator
from typing import Any

State = dict[str, Any]


class Stateful:
    """A part of a run that may change while it goes on. A part without state inherits these."""

    def state(self) -> State:
        """What the part's next answers depend on."""
        return {}

    def restore(self, state: State) -> None:
        """Takes over a state that `state` returned."""


def parts_of(root: Any) -> dict[str, Stateful]:
    """All parts that an object consists of, each once, by their names in it: `front_end`, `back_end.updates`, `back_end.hooks.0` ..."""
    parts: dict[str, Stateful] = {}
    seen: set[int] = {id(root)}
    waiting = list(_attributes(root, ""))
    while waiting:
        name, part = waiting.pop(0)
        if id(part) not in seen:
            seen.add(id(part))
            parts[name] = part
            waiting += _attributes(part, f"{name}.")
    return parts


def _attributes(owner: Any, prefix: str) -> Iterator[tuple[str, Stateful]]:
    """The parts among an object's attributes, in lists too."""
    for name, value in vars(owner).items():
        if isinstance(value, Stateful):
            yield f"{prefix}{name}", value
        elif isinstance(value, list | tuple):
            yield from ((f"{prefix}{name}.{i}", item) for i, item in enumerate(value) if isinstance(item, Stateful))


def plain_adam(state_dict: dict[str, Any]) -> State:
    """An optimiser's `state_dict` as a state: rates, moments and step counts."""
    return {"groups": state_dict["param_groups"], "moments": {str(i): moments for i, moments in state_dict["state"].items()}}


def adam_dict(state: State) -> dict[str, Any]:
    """The `state_dict` that `plain_adam` was given."""
    groups = [group | {"betas": tuple(group["betas"])} for group in state["groups"]]
    return {"param_groups": groups, "state": {int(i): moments for i, moments in state["moments"].items()}}
