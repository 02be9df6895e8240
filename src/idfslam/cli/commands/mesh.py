"""`idf-slam mesh`."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from idfslam.export.formats import Up

if TYPE_CHECKING:
    from rich.console import Console


@dataclass(frozen=True)
class Mesh:
    """Extract the mesh of a saved map at another resolution."""

    folder: Positional[Path]
    """Result folder."""
    resolution: float = 0.02
    """Edge of the marching-cubes cells [m]. The map's own finest cells are 4 cm in the preset `fast`; edges below half of that add
    vertices, not detail."""
    out: Path | None = None
    """Mesh file (.ply, .obj, .glb, .off, .stl). Default: mesh.ply in the result folder."""
    up: Up | None = None
    """Axis that points up in the file: `z` by gravity, `y` by gravity, or `camera`, the axes of trajectory.txt. Default: z, or camera
    for mesh.ply in the result folder. In GLB files y is always up."""
    overwrite: bool = False
    """Replace the file that --out names if it exists."""

    def __call__(self, console: "Console") -> None:
        from idfslam.export.single_mesh import write_mesh

        print(*write_mesh(self.folder, self.out, resolution=self.resolution, up=self.up, overwrite=self.overwrite), sep="\n")
