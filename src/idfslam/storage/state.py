"""The state of a component as plain values, so that a run can be saved and gone on with.

`state()` tells all that the component's next answers depend on and its config does not: tensors, which may share memory with the component,
and what JSON can say, nested in lists and dicts with words for keys. `restore(state)` puts it into a component made with the same config,
whose next answers are then the same to the last bit. What can be worked out again to the last bit (features, image pyramids) is left out.
"""

from typing import Any, Protocol

State = dict[str, Any]


class Stateful(Protocol):
    """A component of a run that changes while it goes on."""

    def state(self) -> State: ...

    def restore(self, state: State) -> None: ...


def plain_adam(found: dict[str, Any]) -> State:
    """An optimiser's `state_dict` as a state: rates, moments and step counts."""
    return {"groups": found["param_groups"], "moments": {str(i): moments for i, moments in found["state"].items()}}


def adam_dict(state: State) -> dict[str, Any]:
    """The `state_dict` that `plain_adam` was given."""
    groups = [group | {"betas": tuple(group["betas"])} for group in state["groups"]]
    return {"param_groups": groups, "state": {int(i): moments for i, moments in state["moments"].items()}}
