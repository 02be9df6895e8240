"""A kernel is compiled anew when a constant or a function that it takes from another file has changed."""

import ast
import os
import shutil
import subprocess
import sys
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import pytest
from numba.core.dispatcher import Dispatcher

from idfslam.compute.kernel_sources import INSTALLATION, fingerprint, kernel_sources

FIND = """
import numpy as np
from idfslam.fusion.kernels.numba_volume import fill_table, find
keys, rows, block = np.full(4, -1, np.int64), np.zeros(4, np.int64), 1 << 20
fill_table(np.array([(block << 42) | (block << 21) | block]), keys, rows)
print(find(0, 0, 0, keys, rows), "from disk" if find.stats.cache_hits else "compiled")
"""


def test_every_file_that_a_kernel_reads_is_a_source() -> None:
    sources = set(kernel_sources())
    assert sorted(file for file in read_by_kernels() if file not in sources) == []


def test_every_file_of_the_list_is_read_by_a_kernel() -> None:
    listed = {file for file in kernel_sources() if file.parent.name != "kernels" and file.name != "constants.py"}
    assert sorted(listed - read_by_kernels()) == []


def test_the_fingerprint_is_that_of_names_and_contents(tmp_path: Path) -> None:
    for file in kernel_sources():
        copy = tmp_path / file.relative_to(INSTALLATION)
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(file, copy)
    same = fingerprint(tmp_path)
    (tmp_path / "sensing" / "depth_noise.py").write_text("BEST = 1")
    changed = fingerprint(tmp_path)
    (tmp_path / "sensing" / "constants.py").touch()
    assert same == fingerprint()
    assert len({same, changed, fingerprint(tmp_path)}) == 3


@pytest.mark.slow
def test_a_changed_constant_is_seen(tmp_path: Path) -> None:
    """A block is entered into a table and looked for. With another packing of coordinates it is not found."""
    shutil.copytree(INSTALLATION, tmp_path / "idfslam", ignore=shutil.ignore_patterns("__pycache__"))
    assert [row_found(tmp_path), row_found(tmp_path)] == ["0 compiled", "0 from disk"]
    packing = tmp_path / "idfslam" / "geometry" / "blocks.py"
    packing.write_text(packing.read_text().replace("OFFSET = 1 << 20", "OFFSET = 1 << 19"))
    assert row_found(tmp_path) == "-1 compiled"


def row_found(installation: Path) -> str:
    kept = {key: value for key, value in os.environ.items() if key != "NUMBA_CACHE_DIR"}
    command = [sys.executable, "-c", FIND]
    return subprocess.run(command, check=True, capture_output=True, text=True, env=kept | {"PYTHONPATH": str(installation)}).stdout.strip()


@cache
def read_by_kernels() -> set[Path]:
    """The files of all kernels, and of all that they name, directly or by way of other names."""
    found: set[tuple[Path, str]] = set()
    for file in INSTALLATION.rglob("*.py"):
        if "njit" in file.read_text():
            module = ".".join(["idfslam", *file.relative_to(INSTALLATION).with_suffix("").parts])
            values = vars(import_module(module)).values()
            kernels = [value.py_func for value in values if isinstance(value, Dispatcher)]
            for name in [kernel.__name__ for kernel in kernels if kernel.__module__ == module]:
                follow(file, name, found)
    return {file for file, _ in found}


def follow(file: Path, name: str, found: set[tuple[Path, str]]) -> None:
    """Adds the definition of a name in a file, and those of the names in it."""
    if (file, name) in found:
        return
    for statement in statements(file):
        if isinstance(statement, ast.ImportFrom):
            for alias in statement.names:
                if name == (alias.asname or alias.name) and (statement.module or "").startswith("idfslam"):
                    spec = find_spec(str(statement.module))
                    assert spec is not None
                    follow(Path(str(spec.origin)), alias.name, found)
        elif name in bound_by(statement):
            found.add((file, name))
            for node in ast.walk(statement):
                if isinstance(node, ast.Name):
                    follow(file, node.id, found)


@cache
def statements(file: Path) -> list[ast.stmt]:
    return ast.parse(file.read_text()).body


def bound_by(statement: ast.stmt) -> set[str]:
    """The names that a statement of a module defines."""
    if isinstance(statement, ast.FunctionDef | ast.ClassDef):
        return {statement.name}
    if isinstance(statement, ast.Assign | ast.AnnAssign):
        targets = statement.targets if isinstance(statement, ast.Assign) else [statement.target]
        return {node.id for target in targets for node in ast.walk(target) if isinstance(node, ast.Name)}
    return set()
