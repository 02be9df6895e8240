"""Kernels are compiled in a second process, before the first run on a machine, or while the first demo builds and renders its room.

Numba compiles one function at a time in a process. It stores compiled functions on disk, where the other process finds them. A process
that compiles runs other copies of some functions than one that finds them on disk, optimised differently: its results differ in the last
bits. So the first run would not be like the ones after it, and could not be resumed.
"""

import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import yaml

from idfslam.compute.backend import Backend, backend_of
from idfslam.compute.cache_folder import kernels_on_disk, prepare_caches
from idfslam.compute.devices import resolve_device
from idfslam.config import FAST, Config, dump, update

_COARSE = 0.2  # [m] cells of a mesh that only serves to compile; smaller: slower


@contextmanager
def compiling_ahead(config: Config) -> Iterator[Callable[[], object]]:
    """Compiles in a second process during the `with` block, unless all is compiled. Gives a function that waits for the first kernels.

    If that process fails, this one compiles each kernel at its first use.
    """
    if (
        prepare_caches().folder is None
        or kernels_on_disk()
        or backend_of(resolve_device(config.device, config.preset)) is not Backend.NUMBA
    ):
        yield lambda: None
        return
    command = [sys.executable, "-m", "idfslam.runs.compile_ahead"]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        with process.stdin:
            process.stdin.write(yaml.safe_dump(dump(config)))
        yield process.stdout.readline
        process.wait()
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


def main() -> None:
    """The second process. It reads a config from stdin, and prints a line once a frame can be processed without compiling."""
    from idfslam.evaluation.mesh_error import mesh_error
    from idfslam.mapping.saved_map import SavedMap
    from idfslam.slam.warm_up import warm_up
    from idfslam.views.image_based_rendering import MapViews

    slam = warm_up(update(FAST, yaml.safe_load(sys.stdin), "the values of the run"))
    print("ready", flush=True)
    slam.finish()
    mesh, poses, camera = slam.mesh(_COARSE), slam.trajectory(), slam.graph.keyframes[0].camera
    mesh_error(mesh, mesh, poses=poses, camera=camera, samples=100, views=1)
    saved, archive = SavedMap(slam.mapper.learnt(), slam.coverage.views(), slam.surface_fusion.volume()), slam.archive()
    (saved if archive is None else MapViews(saved, archive)).render(poses[0], camera)


if __name__ == "__main__":
    main()
