"""A second process compiles what the first demo on a machine needs."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

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


def test_kernels_are_compiled_beside(tmp_path: Path) -> None:
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    told = subprocess.run([sys.executable, "-c", BESIDE], check=True, capture_output=True, text=True, env=environment).stdout.split()
    assert told == ["False", "ready", "True", "None"]
    names = {path.name.split("-")[0] for path in tmp_path.rglob("*.nbi")}
    assert names >= {"numba_field.learn", "numba_alignment.photometric_system", "meshing._vote", "point_triangle.nearest_triangle"}
