"""The source files that compiled kernels are made of, and their fingerprint.

Numba compares a stored kernel with the file that it stands in. A constant or a function that it takes from another file may have changed
since, and Numba does not see that. So kernels are kept by the fingerprint of all these files (`compute/cache_folder.py`).
"""

import hashlib
from pathlib import Path

INSTALLATION = Path(__file__).parents[1]
_FOLDERS = ("*/kernels/*.py", "*/constants.py")
_FILES = (  # kernels elsewhere, and what kernels read there; tests/test_kernel_sources.py says which one is missing
    "datasets/images/depth_registration.py",
    "evaluation/culling.py",
    "evaluation/point_triangle.py",
    "export/tsdf_grid.py",
    "geometry/blocks.py",
    "geometry/cholesky.py",
    "geometry/projection.py",
    "graph/observed_space.py",
    "mapping/meshing.py",
    "scenes/procedural_textures.py",
    "scenes/ray_casting.py",
    "sensing/depth_edges.py",
    "sensing/depth_noise.py",
    "sensing/light_comparison.py",
    "sensing/rectification.py",
    "sensing/shared_places.py",
)


def kernel_sources(installation: Path = INSTALLATION) -> list[Path]:
    """The files in the folder of the package that decide what a kernel computes, in order of their paths."""
    return sorted([*(path for pattern in _FOLDERS for path in installation.glob(pattern)), *(installation / name for name in _FILES)])


def fingerprint(installation: Path = INSTALLATION) -> str:
    """12 hexadecimal digits that change with the name or content of any kernel source."""
    digest = hashlib.sha256()
    for path in kernel_sources(installation):
        source = path.read_bytes()
        digest.update(f"{path.relative_to(installation).as_posix()} {len(source)}\n".encode())
        digest.update(source)
    return digest.hexdigest()[:12]
