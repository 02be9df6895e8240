"""A second process compiles what the first demo on a machine needs."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from idfslam.compute.cache_folder import prepare_caches

pytestmark = pytest.mark.slow

BESIDE = """
from idfslam.config import FAST
from idfslam.compute.cache_folder import kernels_on_disk
from idfslam.runs.compile_ahead import compiling_ahead
print(kernels_on_disk())
with compiling_ahead(FAST) as until_compiled:
    print(until_compiled())
print(kernels_on_disk())
with compiling_ahead(FAST) as until_compiled:
    print(until_compiled())
"""
MISSING = {"numba_field.learn", "numba_landmarks.photometric_system", "meshing._vote", "point_triangle.nearest_triangle"}


def kernel(path: Path) -> str:
    return path.name.split("-")[0]


def test_kernels_are_compiled_beside(tmp_path: Path) -> None:
    """Those that are missing on disk: of a frame, of the mesh and of its evaluation. All of them take two minutes: see `make compiled`."""
    present = prepare_caches().folder
    assert present is not None
    shutil.copytree(present, tmp_path / present.name, ignore=lambda _, names: [name for name in names if kernel(Path(name)) in MISSING])
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    told = subprocess.run([sys.executable, "-c", BESIDE], check=True, capture_output=True, text=True, env=environment).stdout.split()
    assert told == ["False", "ready", "True", "None"]
    assert {kernel(path) for path in tmp_path.rglob("*.nbi")} >= MISSING


REACHED = """
import gc
import io
import sys

import yaml
from numba.core.dispatcher import Dispatcher

from idfslam.config import FAST, dump
from idfslam.datasets import open_recording
from idfslam.runs import compile_ahead
from idfslam.slam import Slam


def compiled():
    # Of the package's own kernels but those that draw generated recordings: names with the types of their arguments.
    of = [(d.py_func.__module__, d) for d in gc.get_objects() if isinstance(d, Dispatcher)]
    own = [(name, d) for name, d in of if name.startswith("idfslam.") and not name.startswith("idfslam.scenes.")]
    return {f"{name}.{d.py_func.__name__}{types}" for name, d in own for types in d.overloads}


sys.stdin = io.StringIO(yaml.safe_dump(dump(FAST)))
compile_ahead.main()
ahead = compiled()
slam = Slam(FAST)
for frame in open_recording("synthetic:0:people:handheld-shutter+time", frames=25):
    slam.process(frame)
slam.finish()
slam.mesh(0.1)
print(len(ahead), sorted(compiled() - ahead))
"""


def test_a_run_compiles_nothing_more() -> None:
    """A process that compiles would run other code than the next one, and wait for it between two frames."""
    told = subprocess.run([sys.executable, "-c", REACHED], check=True, capture_output=True, text=True).stdout.splitlines()
    assert told[0] == "ready"
    number, more = told[1].split(" ", 1)
    assert int(number) > 50
    assert more == "[]"
