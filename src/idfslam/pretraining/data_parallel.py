"""Data-parallel training in the processes that torchrun starts: each works on its share of a step's pairs, then gradients are averaged.

In a single process these functions do nothing.
"""

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import torch
from torch import Tensor, distributed


@dataclass(frozen=True)
class Workers:
    """This process, and the number of processes that train together."""

    rank: int = 0
    count: int = 1

    @property
    def first(self) -> bool:
        """Whether this process writes the files."""
        return self.rank == 0

    def average(self, tensors: Sequence[Tensor]) -> None:
        """Replaces each tensor, of any shape, by its mean over the processes, in one message."""
        if self.count > 1:
            together = torch.cat([tensor.flatten() for tensor in tensors])
            distributed.all_reduce(together)
            for tensor, mean in zip(tensors, (together / self.count).split([tensor.numel() for tensor in tensors])):
                tensor.copy_(mean.view_as(tensor))

    def any(self, flag: bool, device: torch.device) -> bool:
        """Whether the flag is true in any process."""
        raised = torch.tensor(float(flag), device=device)
        if self.count > 1:
            distributed.all_reduce(raised)
        return bool(raised > 0)


@contextmanager
def workers(device: torch.device) -> Iterator[Workers]:
    """Joins the processes of torchrun (NCCL on GPUs, gloo on CPUs). Without torchrun this process is the only one."""
    if int(os.environ.get("WORLD_SIZE", "1")) == 1:
        yield Workers()
        return
    distributed.init_process_group("nccl" if device.type == "cuda" else "gloo")
    try:
        yield Workers(distributed.get_rank(), distributed.get_world_size())
        distributed.barrier()  # a process that leaves early would break the connections of those still working
    finally:
        distributed.destroy_process_group()
