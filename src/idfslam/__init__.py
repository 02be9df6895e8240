"""RGB-D SLAM with a neural tracker and a neural implicit map.

The names below are loaded when they are first used, so that `import idfslam` and `--help` are quick. Their types stand in `__init__.pyi`.
"""

from importlib import import_module
from typing import Any

from idfslam.compute.cache_folder import prepare_caches

__version__ = "0.1.0"

_HOMES = {
    "FAST": "idfslam.config",
    "PAPER": "idfslam.config",
    "Camera": "idfslam.geometry.camera",
    "Config": "idfslam.config",
    "Frame": "idfslam.frame",
    "FrameResult": "idfslam.frame",
    "Slam": "idfslam.slam",
    "Status": "idfslam.frame",
    "open_recording": "idfslam.datasets",
}

prepare_caches()  # before any module of the package imports numba

__all__ = ["FAST", "PAPER", "Camera", "Config", "Frame", "FrameResult", "Slam", "Status", "open_recording"]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'idfslam' has no attribute '{name}'")
    return getattr(import_module(_HOMES[name]), name)
