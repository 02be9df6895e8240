"""What an export needs of memory, estimated from the area of the surface before it begins, and what the map can resolve."""

import logging
import math

from idfslam.compute.host import memory
from idfslam.errors import ConfigError
from idfslam.mapping.saved_map import SavedMap

log = logging.getLogger(__name__)

# Triangles of marching cubes for each r^2 of surface, and their memory [bytes] at the most. Measured on a kitchen at r = 4 to 0.6 cm:
# 2.99 to 3.13 triangles, and 635 bytes at 0.6 cm. Raised, more is refused.
_TRIANGLES, _TRIANGLE_BYTES = 3.0, 650
_POINT_BYTES = 40  # of a lattice point near the surface: its position, distance, colour and marks. Raised, more is refused
_BLOCK = 32  # [cells] around the truncation distance that blocks reach beyond it, on both sides together. Raised, more is refused
_UNKNOWN = 16e9  # [bytes] taken as free where the system does not tell; raised, larger meshes are tried. Chosen by hand


def check_mesh(area: float, resolution: float) -> None:
    """Raises ConfigError if a mesh of `area` [m2] in cells of `resolution` [m] would take more memory than is free."""
    triangles = _TRIANGLES * area / resolution**2
    _check(resolution, triangles * _TRIANGLE_BYTES, f"the mesh would have about {_many(triangles)} triangles", power=2)


def check_blocks(area: float, truncation: float, resolution: float) -> None:
    """The same for the lattice points near a surface of `area` [m2]. truncation: on both sides of the surface [m]."""
    points = area * (2 * truncation + _BLOCK * resolution) / resolution**3
    _check(resolution, points * _POINT_BYTES, f"the blocks would have about {_many(points)} points", power=3)


def finest_cells(saved: SavedMap) -> float | None:
    """Edge [m] of the finest cells of the map: a voxel's, or one of its feature grid; None for a map without either."""
    if saved.volume is not None:
        return saved.volume.voxel
    return saved.field.finest_cells


def log_finest_cells(saved: SavedMap, resolution: float) -> None:
    """Says so if a mesh would be finer than what the map resolves. Between its lattice points the map is nearly linear."""
    finest = finest_cells(saved)
    if finest is not None and resolution < finest / 2:
        text = "the finest cells of the map have %g cm: a mesh in cells of %g cm has more vertices than one of %g cm, but no more detail"
        log.info(text, finest * 100, resolution * 100, finest * 50)


def _check(resolution: float, need: float, what: str, *, power: int) -> None:
    known = memory()
    free = known[1] if known else _UNKNOWN
    if need > free:
        enough = math.ceil(1000 * resolution * (need / free) ** (1 / power)) / 1000
        sizes = f"and need about {need / 1e9:.0f} GB of memory, {free / 1e9:.0f} GB are free"
        raise ConfigError(f"--resolution {resolution}: {what} {sizes}; choose {enough} or more")


def _many(count: float) -> str:
    return f"{count / 1e9:.1f} billion" if count >= 1e9 else f"{count / 1e6:.0f} million"
