"""Adam for the map: torch's for the networks, and a sparse one for the tables of a feature grid."""

import torch

from idfslam.compute.adam import Adam
from idfslam.config import MapperConfig
from idfslam.mapping.field import Field
from idfslam.mapping.grid import GridEncoding, roomy_zeros
from idfslam.mapping.kernels import load, sparse_adam
from idfslam.storage.state import State, adam_dict, plain_adam

MOMENTS = ("exp_avg", "exp_avg_sq")  # torch's names of Adam's moments
# [1] Entries of a loaded map above this count as used: entries are initialised with less. More: fewer count as used. Chosen by hand.
_USED = 1e-3
# [1] Their second moment, with which `load` counts them. Any real squared gradient is larger, so Adam's step does not change. Chosen by
# hand.
_USED_MOMENT = 1e-12


class MapOptimiser:
    """Steps of Adam on all parameters of a field, with the warm-up and the clipping of the config."""

    def __init__(self, field: Field, config: MapperConfig) -> None:
        self.field, self.config, self.steps = field, config, 0
        self.anneal = 1.0  # factor on both learning rates: small steps at the end average the noise of many readings
        self.grid = field.encoding if isinstance(field.encoding, GridEncoding) else None
        self.networks = [p for name, p in field.named_parameters() if not name.endswith("tables")]
        self.adam = Adam(self.networks, lr=config.learning_rate, fused=True)
        for p in self.networks:  # torch makes this state at its first step, but `compiled_field.learn_steps` does not call torch's steps
            self.adam.state[p] = {"step": torch.zeros((), device=p.device), **{name: torch.zeros_like(p) for name in MOMENTS}}
        if self.grid is not None:
            self._forget(self.grid)
        field.requires_grad_(False)

    def state(self) -> State:
        """The moments, the number of steps, and the factor on the learning rates."""
        tables = {} if self.grid is None else {"m": self.m, "v": self.v}
        return {"steps": self.steps, "anneal": self.anneal, "adam": plain_adam(self.adam.state_dict()), **tables}

    def restore(self, state: State) -> None:
        """Takes over `state`. The field must be restored first."""
        self.steps, self.anneal = state["steps"], state["anneal"]
        self.adam.load_state_dict(adam_dict(state["adam"]))
        if self.grid is not None:
            self._forget(self.grid)
            self.m.copy_(state["m"])
            self.v.copy_(state["v"])

    def zero_grad(self) -> None:
        """Clears the gradients of the networks. Each step clears those of the tables."""
        self.adam.zero_grad()

    def step(self) -> None:
        """One step of Adam."""
        rate, table_rate = self.advance()
        for group in self.adam.param_groups:
            group["lr"] = rate
        if self.config.gradient_clip > 0:
            torch.nn.utils.clip_grad_norm_(self.networks, self.config.gradient_clip)
        self.adam.step()
        if self.grid is not None:
            tables, touched = self.grid.tables.detach(), self.grid.touched
            sparse_adam(tables, self.grid.gradient, self.m, self.v, step=self.steps, learning_rate=table_rate, touched=touched)

    def advance(self) -> tuple[float, float]:
        """Counts a step; returns the learning rates of the networks and of the tables for it."""
        self.steps += 1
        rate = self.config.learning_rate * min(1.0, self.steps / max(self.config.warm_up, 1))
        return self.anneal * rate, self.anneal * self.config.table_rate

    def double_tables(self) -> bool:
        """Doubles the tables if they have filled up; returns whether they were. The map stays the same function."""
        c = self.field.config
        if self.grid is None or self.grid.tables.shape[1] >= 2**c.table_log2_max or float(load(self.v).max()) < c.table_load:
            return False
        self.grid.double_tables()
        self._forget(self.grid)  # the load starts at zero again
        return True

    def _forget(self, grid: GridEncoding) -> None:
        """Sets the tables' moments to zero."""
        self.m, self.v = (roomy_zeros(grid.tables.shape, grid.tables.device) for _ in range(2))

    def count_as_used(self) -> None:
        """Marks the learnt entries of a loaded map's tables as used, although they were not learnt in this run."""
        if self.grid is not None:
            self.v = torch.where(self.grid.tables.detach().abs() > _USED, _USED_MOMENT, self.v)
