"""`idf-slam mesh`."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

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
    """Edge of the marching-cubes cells [m]. The map resolves 1 cm in the preset `fast` where the camera
    saw the surface well, 4 cm elsewhere: smaller cells add vertices, not detail."""
    colour: Literal["images", "map"] = "images"
    """Colours of the vertices: of the `images` that the run kept in its archive, or those that the `map` has learnt, which are softer."""
    out: Path | None = None
    """Mesh file (.ply, .obj, .glb, .off, .stl). Default: mesh.ply in the result folder."""
    up: Up | None = None
    """Axis that points up in the file: `z` by gravity, `y` by gravity, or `camera`, the axes of trajectory.txt. Default: z, or camera
    for mesh.ply in the result folder. In GLB files y is always up."""
    overwrite: bool = False
    """Replace the file that --out names if it exists."""

    def __call__(self, console: "Console") -> None:
        from idfslam.export.single_mesh import write_mesh

        of_map = self.colour == "map"
        print(*write_mesh(self.folder, self.out, resolution=self.resolution, of_map=of_map, up=self.up, overwrite=self.overwrite), sep="\n")
