"""Times the grid encoding's kernels, and the sparse Adam step against torch's dense one, on rays in a room.

    NUMBA_NUM_THREADS=2 python benchmarks/grid.py --points 49152 --features 2

Prints milliseconds a call, fastest and median of `--repeats`, wall clock: `forward` features; `points` and `tables` the two
backward passes; `step` the Adam step after one backward pass.
"""

import time
from collections.abc import Callable

import numpy as np
import torch
import tyro
from torch import Tensor

from idfslam.compute.backend import Backend
from idfslam.mapping.kernels import grid_encode, sparse_adam

BETAS = (0.9, 0.99)


def room_points(count: int, generator: torch.Generator) -> Tensor:
    """Samples (N, 3) [m] of random rays from near the middle of a room of 6 x 5 x 3 m: per ray 8 within 10 cm of the wall, 4 before it."""
    rays = -(-count // 12)
    origins = torch.rand(rays, 3, generator=generator) - 0.5
    directions = torch.nn.functional.normalize(torch.randn(rays, 3, generator=generator), dim=1)
    depth = ((directions.sign() * torch.tensor([3.0, 2.5, 1.5]) - origins) / directions).amin(1, keepdim=True)
    near = depth + 0.2 * torch.rand(rays, 8, generator=generator) - 0.1
    free = depth * (0.2 + 0.75 * torch.rand(rays, 4, generator=generator))
    samples = torch.cat([free, near], 1)
    return (origins[:, None] + samples[..., None] * directions[:, None]).reshape(-1, 3)[:count].contiguous()


def milliseconds(call: Callable[[], object], *, repeats: int, device: str, before: Callable[[], object] = lambda: None) -> str:
    """Fastest and median of the repeats; `before` runs untimed ahead of each."""
    durations = []
    for repeat in range(repeats + 1):  # the first compiles and warms the cache
        before()
        if device == "cuda":
            torch.cuda.synchronize()
        start = time.perf_counter()
        call()
        if device == "cuda":
            torch.cuda.synchronize()
        if repeat:
            durations.append(1e3 * (time.perf_counter() - start))
    return f"{min(durations):7.2f} {np.median(durations):7.2f}"


def time_grid(backend: Backend, points: Tensor, tables: Tensor, cells: Tensor, *, repeats: int) -> dict[str, str]:
    """Timings of one backend by operation."""
    device = points.device.type
    grad = torch.randn(len(points), tables.shape[0] * tables.shape[2], device=device)
    buffer, m, v = (torch.zeros_like(tables) for _ in range(3))

    def encode(*, by_points: bool, by_tables: bool) -> Tensor:
        x, t = points.detach().requires_grad_(by_points), tables.detach().requires_grad_(by_tables)
        return grid_encode(x, t, cells, backend=backend, accumulate_into=buffer)

    by_points, by_tables = encode(by_points=True, by_tables=False), encode(by_points=False, by_tables=True)
    calls: dict[str, Callable[[], object]] = {
        "forward": lambda: grid_encode(points, tables, cells, backend=backend),
        "points": lambda: by_points.backward(grad, retain_graph=True),
        "tables": lambda: by_tables.backward(grad, retain_graph=True),
    }
    times = {name: milliseconds(call, repeats=repeats, device=device) for name, call in calls.items()}
    values = tables.clone()
    times["step"] = milliseconds(
        lambda: sparse_adam(values, buffer, m, v, step=10, learning_rate=0.01, betas=BETAS, backend=backend),
        repeats=repeats,
        device=device,
        before=calls["tables"],
    )
    return times


def time_dense_adam(points: Tensor, tables: Tensor, cells: Tensor, *, fused: bool, repeats: int) -> str:
    """torch.optim.Adam on the same gradient, with the zeroing of the gradient that the sparse step includes."""
    parameter = tables.clone().requires_grad_()
    parameter.grad = torch.zeros_like(tables)
    optimiser = torch.optim.Adam([parameter], lr=0.01, betas=BETAS, eps=1e-15, fused=fused)

    def backward() -> None:
        grid_encode(points, parameter, cells, accumulate_into=parameter.grad).sum().backward()

    def step() -> None:
        optimiser.step()
        optimiser.zero_grad(set_to_none=False)

    return milliseconds(step, repeats=repeats, device=points.device.type, before=backward)


def main(points: int = 49152, levels: int = 8, features: int = 2, log2_size: int = 17, repeats: int = 20, device: str = "cpu") -> None:
    """Time every backend that the device has."""
    generator = torch.Generator().manual_seed(0)
    x = room_points(points, generator).to(device)
    tables = torch.randn(levels, 2**log2_size, features, generator=generator).to(device)
    cells = torch.logspace(np.log10(0.64), np.log10(0.02), levels).to(device)
    backends = (Backend.TORCH, Backend.TRITON) if device == "cuda" else (Backend.TORCH, Backend.NUMBA)
    print(f"{points} points, {levels} levels x {features} features, 2^{log2_size} entries; ms a call, fastest and median of {repeats}")
    rows = {backend.value: time_grid(backend, x, tables, cells, repeats=repeats) for backend in backends}
    print(f"{'':10}" + "".join(f"{operation:>16}" for operation in rows["torch"]))
    for name, times in rows.items():
        print(f"{name:10}" + "".join(f"{value:>16}" for value in times.values()))
    for fused in (False, True):
        print(f"dense Adam of torch, fused={fused}: {time_dense_adam(x, tables, cells, fused=fused, repeats=repeats)}")


if __name__ == "__main__":
    tyro.cli(main)
