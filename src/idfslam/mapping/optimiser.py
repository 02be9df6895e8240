"""Adam for the map: torch's for the networks, a sparse one for the tables of a feature grid."""

from collections.abc import Iterator
from contextlib import contextmanager

import torch

from idfslam.config import MapperConfig
from idfslam.mapping.field import Field
from idfslam.mapping.grid import GridEncoding, roomy_zeros
from idfslam.mapping.kernels import load, sparse_adam
from idfslam.storage.state import State, adam_dict, plain_adam

MOMENTS = ("exp_avg", "exp_avg_sq")  # as torch names Adam's
_USED = 1e-3  # entries of a loaded map above this count as used: entries are initialised with less
_USED_MOMENT = 1e-12  # their second moment, so that `load` counts them without changing Adam's step: any real squared gradient is larger


class MapOptimiser:
    """One step for all of a field's parameters, with the warm-up and the clipping of the config."""

    def __init__(self, field: Field, config: MapperConfig) -> None:
        self.field, self.config, self.steps = field, config, 0
        self.anneal = 1.0  # both rates are multiplied by it: small steps at the end average the noise of many readings
        self.grid = field.encoding if isinstance(field.encoding, GridEncoding) else None
        self.networks = [p for name, p in field.named_parameters() if not name.endswith("tables")]
        self.adam = torch.optim.Adam(self.networks, lr=config.learning_rate, fused=True)
        for p in self.networks:  # what torch would set up at the first step: `fused.learn_steps` takes steps of its own
            self.adam.state[p] = {"step": torch.zeros((), device=p.device), **{name: torch.zeros_like(p) for name in MOMENTS}}
        if self.grid is not None:
            self._forget(self.grid)
        field.requires_grad_(False)

    def state(self) -> State:
        """Moments, steps and rates."""
        tables = {} if self.grid is None else {"m": self.m, "v": self.v}
        return {"steps": self.steps, "anneal": self.anneal, "adam": plain_adam(self.adam.state_dict()), **tables}

    def restore(self, state: State) -> None:
        """Takes over `state`, for a field that is restored already."""
        self.steps, self.anneal = state["steps"], state["anneal"]
        self.adam.load_state_dict(adam_dict(state["adam"]))
        if self.grid is not None:
            self._forget(self.grid)
            self.m.copy_(state["m"])
            self.v.copy_(state["v"])

    def zero_grad(self) -> None:
        """Forget the gradients of the networks; those of the tables are zeroed as they are used."""
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
        """Counts a step; the learning rates of networks and tables for it."""
        self.steps += 1
        rate = self.config.learning_rate * min(1.0, self.steps / max(self.config.warm_up, 1))
        return self.anneal * rate, self.anneal * self.config.table_rate

    def grow(self) -> bool:
        """Double the tables when they fill up; the map stays the same function."""
        c = self.field.config
        if self.grid is None or self.grid.tables.shape[1] >= 2**c.table_log2_max or float(load(self.v).max()) < c.table_load:
            return False
        self.grid.grow()
        self._forget(self.grid)  # the load counts anew
        return True

    def _forget(self, grid: GridEncoding) -> None:
        """The tables' moments are zero."""
        self.m, self.v = (roomy_zeros(grid.tables.shape, grid.tables.device) for _ in range(2))

    def count_as_used(self) -> None:
        """Entries of a loaded map's tables count as used, although they were not learnt in this run."""
        if self.grid is not None:
            self.v = torch.where(self.grid.tables.detach().abs() > _USED, _USED_MOMENT, self.v)

    @contextmanager
    def learning(self) -> Iterator[None]:
        """Within, the map's parameters gather gradients; elsewhere they are frozen, so that queries cannot disturb them."""
        self.field.requires_grad_(True)
        try:
            yield
        finally:
            self.field.requires_grad_(False)
