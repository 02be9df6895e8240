"""Grid encoding: hand-worked values, and every implementation against the reference in value and gradients."""

import importlib
import importlib.util
import os

import numpy as np
import pytest
import torch
from torch import Tensor

from idfslam.compute.backend import Backend
from idfslam.mapping.kernels import grid_encode, grid_scatter, load, sparse_adam, torch_grid, touched_runs

HAS_TRITON = importlib.util.find_spec("triton") is not None
INTERPRETED = os.environ.get("TRITON_INTERPRET") == "1"
needs_triton = pytest.mark.skipif(
    not HAS_TRITON or not (INTERPRETED or torch.cuda.is_available()), reason="needs triton with a CUDA device or TRITON_INTERPRET=1"
)
COMPILED = ["numba", pytest.param("triton", marks=needs_triton)]
CELLS = (0.5, 0.25, 0.13, 0.07)  # the first two are powers of two: positions on their lattice planes are exact in float32


def device(implementation: str) -> str:
    return "cuda" if implementation == "triton" and not INTERPRETED else "cpu"


def grid(implementation: str, *, features: int = 2, size: int = 256, count: int = 700) -> tuple[Tensor, Tensor, Tensor]:
    """Random points in a cube of +-3 m, a tenth of them on lattice planes, tables and cells on the implementation's device."""
    generator = torch.Generator().manual_seed(0)
    points = 6 * torch.rand(count, 3, generator=generator) - 3
    points[: count // 10] = (points[: count // 10] / 0.5).round() * 0.5
    tables = torch.randn(len(CELLS), size, features, generator=generator)
    where = device(implementation)
    return points.to(where), tables.to(where), torch.tensor(CELLS, device=where)


def test_hash_by_hand() -> None:
    # Three bits say where in its block of 2 x 2 x 2 a vertex lies. Blocks, modulo 4: the primes are 1, 1 (..761 = 190 * 4 + 1) and
    # 1 (..861 = 215 * 4 + 1); -1 is the last place of block -1, which is 3 modulo 4.
    vertices = torch.tensor([[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1], [2, 0, 0], [2, 2, 3], [-1, 0, 0]])
    assert torch_grid.hash_vertices(vertices, 32).tolist() == [1, 2, 4, 7, 8, 8 * (1 ^ 1 ^ 1) + 4, 8 * 3 + 1]


def test_hash_wraps_like_uint32() -> None:
    vertices = torch.randint(-(2**20), 2**20, (1000, 3), generator=torch.Generator().manual_seed(0))
    x, y, z = (vertices.numpy().astype(np.int32) >> 1).view(np.uint32).T
    block = x ^ (y * np.uint32(2_654_435_761)) ^ (z * np.uint32(805_459_861))
    expected = (block * np.uint32(8) + (vertices.numpy() & 1) @ np.array([1, 2, 4], np.uint32)) & np.uint32(2**17 - 1)
    assert np.array_equal(torch_grid.hash_vertices(vertices, 2**17).numpy(), expected)


def test_a_block_lies_in_one_cache_line() -> None:
    block = torch.tensor([[2 * 5 + i, 2 * -3 + j, 2 * 8 + k] for k in (0, 1) for j in (0, 1) for i in (0, 1)])
    entries = torch_grid.hash_vertices(block, 2**12)
    assert entries.tolist() == list(range(int(entries[0]), int(entries[0]) + 8)) and int(entries[0]) % 8 == 0


@pytest.mark.parametrize("implementation", ["torch", *COMPILED])
def test_value_by_hand(implementation: str) -> None:
    # One level, cell 2 m, point (-0.5, 1, 3) m: position (-0.25, 0.5, 1.5), lower vertex (-1, 0, 1), fraction (0.75, 0.5, 0.5).
    # A table of eight entries holds one block: a vertex is hashed to the parities p of x, y, z, where the table has p_x + 2 p_y + 4 p_z.
    # Of x a quarter is odd, of y and z a half: 0.25 + 1 + 2.
    where = device(implementation)
    tables = torch.arange(8.0, device=where).view(1, 8, 1)
    point, cells = torch.tensor([[-0.5, 1.0, 3.0]], device=where), torch.tensor([2.0], device=where)
    assert grid_encode(point, tables, cells, backend=Backend(implementation)).item() == pytest.approx(3.25)
    # At (-0.5, 0, 2) only x is between vertices: 0.25 + 0 + 4. In 2 m, forward from there, x falls by 1, y rises by 2, z falls by 4.
    point = torch.tensor([[-0.5, 0.0, 2.0]], device=where)
    value = grid_encode(point.requires_grad_(), tables, cells, backend=Backend(implementation))
    (slope,) = torch.autograd.grad(value, point)
    assert value.item() == pytest.approx(4.25)
    assert slope.flatten().tolist() == pytest.approx([-0.5, 1.0, -2.0])


@pytest.mark.parametrize("features", [2, 4])
@pytest.mark.parametrize("implementation", COMPILED)
def test_equal_to_reference(implementation: str, features: int) -> None:
    points, tables, cells = grid(implementation, features=features)
    weight = torch.randn(len(points), len(CELLS) * features, generator=torch.Generator().manual_seed(1)).to(points.device)
    results = []
    for encode in (torch_grid.forward, lambda *inputs: grid_encode(*inputs, backend=Backend(implementation))):
        x, t = points.clone().requires_grad_(), tables.clone().requires_grad_()
        out = encode(x, t, cells)
        (out * weight).sum().backward()
        results.append((out.detach(), x.grad, t.grad))
    # Values are sums of 8 float32 terms of size 1; gradients by points have the factor 1 / 0.07; those by tables are sums of ~100 terms.
    for expected, actual, tolerance in zip(*results, (2e-6, 2e-4, 2e-5)):
        assert torch.allclose(expected, actual, rtol=1e-5, atol=tolerance)


def test_reference_against_finite_differences() -> None:
    points, tables, cells = (tensor.double() for tensor in grid("torch", size=16, count=12))
    points = points + 0.011  # off the planes, where the derivative jumps
    inputs = (points.requires_grad_(), tables.requires_grad_())
    assert torch.autograd.gradcheck(lambda x, t: grid_encode(x, t, cells, backend=Backend.TORCH), inputs)


@pytest.mark.parametrize("implementation", ["torch", *COMPILED])
def test_continuous_across_lattice_planes(implementation: str) -> None:
    _, tables, cells = grid(implementation)
    on = torch.tensor([[-1.0, 0.0, 0.5], [0.0, 0.0, 0.0], [-0.5, -1.5, 2.0]], device=tables.device)
    below = torch.nextafter(on, torch.full_like(on, -10.0))
    encode = lambda x: grid_encode(x, tables, cells, backend=Backend(implementation))  # noqa: E731
    assert torch.allclose(encode(on), encode(below), atol=1e-4)  # slopes are below ~100 per metre, the step is 1e-7 m
    # On a plane of the first level the feature is the vertex's own entry: no weight is left for the others.
    entry = torch_grid.hash_vertices((on / 0.5).long(), tables.shape[1])
    assert torch.equal(encode(on)[:, :2], tables[0, entry])


@pytest.mark.parametrize("implementation", ["torch", *COMPILED])
def test_doubling_is_exact(implementation: str) -> None:
    points, tables, cells = grid(implementation)
    before = grid_encode(points, tables, cells, backend=Backend(implementation))
    doubled = torch.cat([tables, tables], dim=1)
    assert torch.equal(before, grid_encode(points, doubled, cells, backend=Backend(implementation)))


@pytest.mark.parametrize("implementation", ["torch", *COMPILED])
def test_no_points(implementation: str) -> None:
    _, tables, cells = grid(implementation)
    x, t = torch.zeros(0, 3, device=tables.device, requires_grad=True), tables.clone().requires_grad_()
    out = grid_encode(x, t, cells, backend=Backend(implementation))
    out.sum().backward()
    assert out.shape == (0, 8)
    assert x.grad is not None and x.grad.shape == (0, 3)
    assert t.grad is not None and not t.grad.any()


@pytest.mark.parametrize("implementation", ["torch", *COMPILED])
def test_accumulates_into_a_buffer(implementation: str) -> None:
    points, tables, cells = grid(implementation)
    tables.requires_grad_()
    (expected,) = torch.autograd.grad(grid_encode(points, tables, cells, backend=Backend(implementation)).square().sum(), tables)
    buffer = torch.ones_like(tables)
    grid_encode(points, tables, cells, backend=Backend(implementation), accumulate_into=buffer).square().sum().backward()
    assert tables.grad is None
    assert torch.allclose(buffer - 1, expected, rtol=1e-5, atol=5e-5)  # float32 sums of up to 100 terms in another order


@pytest.mark.parametrize("implementation", ["numba", "torch"])
def test_only_the_gradients_asked_for(implementation: str, monkeypatch: pytest.MonkeyPatch) -> None:
    module = importlib.import_module(f"idfslam.mapping.kernels.{implementation}_grid")
    points, tables, cells = grid(implementation)

    def forbidden(*_: Tensor) -> Tensor:
        raise AssertionError("computed a gradient that nobody asked for")

    with monkeypatch.context() as patch:
        patch.setattr(module, "backward_points", forbidden)
        t = tables.clone().requires_grad_()
        grid_encode(points, t, cells, backend=Backend(implementation)).sum().backward()
    monkeypatch.setattr(module, "backward_tables", forbidden)
    x = points.clone().requires_grad_()
    grid_encode(x, tables, cells, backend=Backend(implementation)).sum().backward()


@pytest.mark.parametrize("implementation", ["torch", *COMPILED])
def test_a_point_that_is_not_finite_yields_nan(implementation: str) -> None:
    points, tables, cells = grid(implementation, count=20)
    points[3, 1], points[5, 0] = torch.nan, torch.inf
    finite = grid_encode(points, tables, cells, backend=Backend(implementation)).isfinite().all(1)
    assert not finite[3] and not finite[5] and finite.sum() == 18


def test_inputs_outside_the_contract() -> None:
    points, tables, cells = grid("numba")
    with pytest.raises(ValueError, match="power of two"):
        grid_encode(points, tables[:, :100].contiguous(), cells)
    with pytest.raises(ValueError, match="expected \\(N, 3\\)"):
        grid_encode(points[:, :2], tables, cells)
    with pytest.raises(ValueError, match="expected float32"):
        grid_encode(points.double(), tables, cells)
    with pytest.raises(ValueError, match="one for each of 4 levels"):
        grid_encode(points, tables, cells[:2])


@pytest.mark.parametrize("implementation", ["torch", *COMPILED])
def test_sparse_adam_is_adam_where_every_gradient_is_nonzero(implementation: str) -> None:
    _, tables, _ = grid(implementation)
    expected = tables.clone().requires_grad_()
    optimiser = torch.optim.Adam([expected], lr=0.01, betas=(0.9, 0.99), eps=1e-15)
    m, v = torch.zeros_like(tables), torch.zeros_like(tables)
    for step in range(1, 6):
        expected.grad = torch.randn(tables.shape, generator=torch.Generator().manual_seed(step)).to(tables.device)
        grad = expected.grad.clone()
        optimiser.step()
        sparse_adam(tables, grad, m, v, step=step, learning_rate=0.01, backend=Backend(implementation))
        assert not grad.any()
    assert torch.allclose(tables, expected, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("implementation", ["torch", *COMPILED])
def test_adam_that_looks_where_it_is_told_to_is_the_same(implementation: str) -> None:
    points, tables, cells = grid(implementation, size=2**12)
    g_features = torch.randn(20, len(CELLS) * 2, generator=torch.Generator().manual_seed(1)).to(points.device)
    results = []
    for touched in (None, touched_runs(tables)):
        moved, grad, m, v = tables.clone(), *(torch.zeros_like(tables) for _ in range(3))
        for step in (1, 2):
            grid_scatter(points[20 * step :][:20], cells, g_features, grad, touched=touched, backend=Backend(implementation))
            if touched is not None and implementation == "numba":
                runs = (grad != 0).any(-1).unflatten(1, (-1, 64)).any(-1)
                assert bool((touched > 0)[runs].all()) and 0 < int((touched > 0).sum()) < runs.numel()
            sparse_adam(moved, grad, m, v, step=step, learning_rate=0.01, touched=touched, backend=Backend(implementation))
            assert not grad.any()
        results.append(moved)
    assert not torch.equal(results[0], tables)
    assert touched is not None and not touched.any()
    torch.testing.assert_close(*results, rtol=0, atol=0 if implementation == "numba" else 1e-6)


@pytest.mark.parametrize("implementation", ["torch", *COMPILED])
def test_sparse_adam_leaves_the_rest_alone(implementation: str) -> None:
    where = device(implementation)
    tables, grad, m, v = (torch.zeros(2, 4, 2, device=where) for _ in range(4))
    m[0, 1], v[0, 1] = 0.5, 0.25  # moments of an entry that is not touched now: no step, no decay
    grad[1, 2, 0] = -3.0
    sparse_adam(tables, grad, m, v, step=100, learning_rate=0.01, backend=Backend(implementation))
    # m = 0.1 * -3, v = 0.01 * 9: the step is 0.01 * 0.3 / 0.3 up to the bias corrections 1 - 0.9^100 and sqrt(1 - 0.99^100) = 0.796.
    assert tables[1, 2, 0].item() == pytest.approx(0.01 * 0.7960, rel=1e-3)
    assert tables.count_nonzero() == 1 and m[0, 1, 0] == 0.5 and v[0, 1, 0] == 0.25
    assert load(v).tolist() == [0.25, 0.25]  # one entry of four on each level


def test_sparse_adam_invalidates_graphs_that_need_the_old_tables() -> None:
    points, tables, cells = grid("numba")
    features = grid_encode(points.requires_grad_(), tables, cells)
    zeros = torch.zeros_like(tables)
    sparse_adam(tables, torch.ones_like(tables), zeros, zeros.clone(), step=1, learning_rate=0.1)
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        features.sum().backward()
