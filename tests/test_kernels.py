"""What all compiled kernels have in common."""

import ast
import importlib
import inspect
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from numba.core.registry import CPUDispatcher

import idfslam

PACKAGE = Path(idfslam.__file__).parent


def kernels() -> Iterator[Any]:
    """All functions that Numba compiles."""
    for path in PACKAGE.rglob("*.py"):
        if "njit" in path.read_text():
            module = importlib.import_module(".".join(("idfslam", *path.relative_to(PACKAGE).with_suffix("").parts)))
            yield from (f for f in vars(module).values() if isinstance(f, CPUDispatcher) and f.py_func.__module__ == module.__name__)


def called(kernel: Any) -> set[Any]:
    """The kernels that a kernel calls by name."""
    body = ast.parse(inspect.getsource(kernel.py_func).strip())
    names = {node.func.id for node in ast.walk(body) if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)}
    known = [kernel.py_func.__globals__.get(name) for name in names]
    return {f for f in known if isinstance(f, CPUDispatcher)}


def reorders(kernel: Any) -> bool:
    """Whether sums and products of a kernel may be put together in another order."""
    allowed = kernel.targetoptions.get("fastmath", False)
    return allowed is True or bool(set(allowed or ()) & {"reassoc", "contract", "arcp"})


def test_kernels_whose_sums_may_be_reordered_are_inlined_where_they_are_called() -> None:
    """Otherwise a kernel that was just compiled rounds differently from the same one in the cache (`mapping/kernels/numba_grid.py`)."""
    found = list(kernels())
    assert sum(reorders(kernel) for kernel in found) > 20
    loose = {
        f"{kernel.__name__} calls {helper.__name__}"
        for kernel in found
        for helper in called(kernel)
        if reorders(helper) and not helper.targetoptions.get("forceinline", False)
    }
    assert not loose
