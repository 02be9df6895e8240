"""`idf-slam mesh`."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

if TYPE_CHECKING:
    from rich.console import Console


@dataclass(frozen=True)
class Mesh:
    """The mesh of a saved map at another resolution."""

    folder: Positional[Path]
    """Result folder."""
    resolution: float = 0.02
    """Edge of the marching-cubes cells [m]."""
    out: Path | None = None
    """Mesh file (.ply, .obj, .glb, ...); none given: mesh.ply in the result folder."""

    def __call__(self, console: "Console") -> None:
        from idfslam.pictures.map_views import write_mesh

        print(write_mesh(self.folder, self.out, resolution=self.resolution))
