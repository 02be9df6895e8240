"""`idf-slam export`."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from idfslam.export.formats import Format, Texture

if TYPE_CHECKING:
    from rich.console import Console


@dataclass(frozen=True)
class Export:
    """A run for other programs: poses, posed images, meshes, points, grids.

    tum: poses of all frames, t tx ty tz qx qy qz qw.  kitti: the same as 3 x 4 matrices.
    nerfstudio: transforms.json with images, depth and points.  colmap: a text model with images and points.
    ply, obj, glb: the mesh.  points: a coloured point cloud of the depth images (PLY).
    grid: T-SDF, colour and what was observed on a dense grid (npz).  blocks: the same, only near the surface.
    """

    folder: Positional[Path]
    """Result folder."""
    to: tuple[Format, ...]
    """One or more formats."""
    resolution: float = 0.02
    """Cell edge of meshes and grids, and spacing of points [m]."""
    images: int | None = None
    """Number of frames whose images and points are exported, spread over the run; none given: the keyframes, with those of the
    map that the run started in."""
    texture: Texture | None = None
    """Texture of OBJ and GLB, from the images of the recording or the colours of the map; none given: vertex colours."""
    recording: Path | None = None
    """New path of the recording, if it was moved after the run."""
    out: Path | None = None
    """Folder of the files; none given: export/ in the result folder."""

    def __call__(self, console: "Console") -> None:
        from idfslam.export.exporter import Exporter
        from idfslam.runs.finished_run import FinishedRun

        out = self.out or self.folder / "export"
        run = FinishedRun(self.folder, moved=self.recording)
        exporter = Exporter(run, out, self.resolution, self.images, self.texture)
        print(*exporter.write(self.to), sep="\n")
