"""Examines the machine: what it has, what a run would use, and what is missing."""

import os
import platform
import re
from dataclasses import dataclass, replace
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import Any

import torch

from idfslam import __version__
from idfslam.compute import host
from idfslam.compute.backend import backend_of
from idfslam.compute.cache_folder import prepare_caches
from idfslam.compute.devices import KEPT_ON_CPU, bf16_pays, resolve_device, resolve_precision
from idfslam.config import Config, TrackerConfig
from idfslam.errors import IdfSlamError, pip_install
from idfslam.mapping.compiled_field import compilable
from idfslam.mapping.field import grids_of
from idfslam.slam import System
from idfslam.tracking.features import load_extractor

GIB = 2**30
_LITTLE_MEMORY = 2 * GIB  # less available memory causes advice; a run takes 0.9 GiB (docs/results.md)
_LITTLE_DISK = GIB // 2  # less free space causes advice; a result folder takes some tens of megabytes
_PACKAGES = ("numpy", "numba", "opencv-python-headless", "trimesh")
DEVICES = {
    "preset fast": "CPU; never tried on a GPU (--device cuda)",
    "preset paper": "GPU if there is one, else CPU; never tried on a GPU",
    "presets imap, nice": "GPU if there is one, else CPU; never tried on a GPU",
    "pretraining": "GPU if there is one, else CPU; never tried on a GPU",
    "Triton kernels": "never tried on a GPU, only in Triton's interpreter",
    "meshing, pose graph": "CPU, whatever the device",
}
"""What runs where, and what was never tried on a GPU."""
_REQUIREMENT = re.compile(r"^(?P<package>[\w.-]+).*\bextra\s*==\s*['\"](?P<extra>[\w-]+)['\"]")


@dataclass(frozen=True)
class Examination:
    """The properties of the machine, and what should be fixed. The machine is ready if there is nothing to fix."""

    found: dict[str, Any]  # plain values, ready for JSON
    advice: list[str]

    @property
    def ready(self) -> bool:
        return not self.advice


def examine(config: Config, folder: Path = Path()) -> Examination:
    """Examines this machine for runs with `config` whose results go to `folder`."""
    advice: list[str] = []
    found = {
        "idf-slam": __version__,
        "system": platform.platform(),
        "python": platform.python_version(),
        "packages": {name: version(name) for name in _PACKAGES},
        "torch": _torch(),
        "processor": {"name": host.processor(), "cores": host.cores(), "instruction_sets": host.instruction_sets()},
        "threads": {name: os.environ.get(name) for name in ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS", "OMP_WAIT_POLICY")},
        "memory_bytes": _memory(advice),
        "free_disk_bytes": _disk(folder, advice),
        "numba_cache": _numba_cache(advice),
        "weights": _weights(config, advice),
        "devices": DEVICES,
        "extras": extras(),
        "used": _used(config, advice),
    }
    return Examination(found, advice)


def _torch() -> dict[str, Any]:
    names = [torch.cuda.get_device_name(i) for i in range(torch.cuda.device_count())] if torch.cuda.is_available() else []
    return {"version": torch.__version__, "cuda": torch.version.cuda, "gpus": names, "bf16_pays_on_cpu": bf16_pays(torch.device("cpu"))}


def _memory(advice: list[str]) -> dict[str, int] | None:
    sizes = host.memory()
    if sizes is not None and sizes[1] < _LITTLE_MEMORY:
        advice.append(f"{sizes[1] / GIB:.1f} GiB of memory are available, a run takes about 1: close other programs")
    return None if sizes is None else {"total": sizes[0], "available": sizes[1]}


def _disk(folder: Path, advice: list[str]) -> int:
    free = host.free_disk(folder)
    if free < _LITTLE_DISK:
        advice.append(f"{free / GIB:.2f} GiB are free at {folder.absolute()}: make room, or choose another place with --out")
    return free


def _numba_cache(advice: list[str]) -> dict[str, Any]:
    """The folder of compiled kernels, and their number. With none, the first run compiles for most of a minute."""
    found = prepare_caches()
    if found.folder is None:
        advice.append(str(found.problem))
        return {"folder": None, "kernels": 0, "writable": False}
    return {"folder": str(found.folder), "kernels": sum(1 for _ in found.folder.rglob("*.nbc")), "writable": True}


def _weights(config: Config, advice: list[str]) -> dict[str, Any]:
    try:
        load_extractor(config.tracker.weights)
    except (IdfSlamError, OSError) as error:
        advice.append(f"the tracker's weights: {error}" + ("" if config.tracker.weights else "; install the package again"))
        return {"path": str(config.tracker.weights or "shipped"), "loaded": False}
    return {"path": str(config.tracker.weights or "shipped"), "loaded": True}


def extras() -> dict[str, dict[str, Any]]:
    """The extras that the package declares: for each, installed packages, missing packages, and the command that installs them."""
    try:
        declared = requires("idf-slam") or []
    except PackageNotFoundError:  # used from its sources without being installed
        declared = []
    found: dict[str, dict[str, Any]] = {}
    for match in filter(None, map(_REQUIREMENT.match, declared)):
        name, package = match["extra"], match["package"]
        if package.lower() == "idf-slam":
            continue  # an extra made of others
        entry = found.setdefault(name, {"installed": {}, "missing": []})
        try:
            entry["installed"][package] = version(package)
        except PackageNotFoundError:
            entry["missing"].append(package)
    return {name: entry | {"install": pip_install(*entry["installed"], *entry["missing"])} for name, entry in found.items()}


def _used(config: Config, advice: list[str]) -> dict[str, Any] | None:
    """Device, precision and kernels of a run; None where it would end with an error, which is then the advice."""
    try:
        device = resolve_device(config.device, config.preset)
    except IdfSlamError as error:
        advice.append(str(error))
        return None
    if config.device == "auto" and config.preset not in KEPT_ON_CPU and torch.version.cuda and not torch.cuda.is_available():
        advice.append("this torch is built for CUDA but finds no GPU: check the driver with nvidia-smi; runs use the CPU meanwhile")
    field = System(replace(config, tracker=TrackerConfig())).map.learnt()
    kernels = "numba, fused" if compilable(field) else backend_of(device).value if any(grids_of(field)) else "torch"
    return {
        "preset": config.preset,
        "device": str(device),
        "tracker_precision": str(resolve_precision(config.tracker.precision, device)).removeprefix("torch."),
        "map_precision": "bfloat16" if field.bf16 else "float32",
        "kernels": kernels,
    }
