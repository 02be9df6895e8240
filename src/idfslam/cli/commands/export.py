"""`idf-slam export`."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from idfslam.export.formats import Format, Lost, Texture, Up

if TYPE_CHECKING:
    from rich.console import Console


@dataclass(frozen=True)
class Export:
    """Export a run for other programs: poses, posed images, meshes, points, grids, or a page for the browser.

    tum: poses of all frames, t tx ty tz qx qy qz qw.  kitti: the same as 3 x 4 matrices.
    nerfstudio: transforms.json with images, depth and points.  colmap: a text model with images and points.
    ply, obj, glb: the mesh.  points: a coloured point cloud of the depth images (PLY).  splats: 3D Gaussian splats on the mesh (PLY).
    page: scene.html, the scene in three dimensions for any browser, in one file.
    masks: what moves in each image that the run kept, as black pixels (PNG).
    grid: T-SDF, colour and observed cells on a dense grid (npz).  blocks: the same, only near the surface.
    All formats of one command share their axes (--up); transform.json describes them.
    """

    folder: Positional[Path]
    """Result folder."""
    to: tuple[Format, ...]
    """One or more formats."""
    resolution: float = 0.02
    """Cell edge of meshes and grids, and spacing of points [m]. The map resolves 1 cm in the preset `fast` where the camera
    saw the surface well, 4 cm elsewhere: smaller cells add vertices, not detail."""
    up: Up = "z"
    """Axis that points up in the files. `z`: up by gravity, as the floor shows it, the walls along x and y. `y`: the same with y up.
    `camera`: the axes of the run's own trajectory.txt and mesh.ply (the first camera: x right, y down, z forward). In GLB files y is
    always up, since glTF demands it."""
    lost: Lost | None = None
    """Frames whose pose was not measured (lost, interpolated). `keep`: they are exported and marked. `drop`: they are left out.
    Default: trajectories keep them, marked, and posed images leave them out. Doubtful frames are treated in the same way, but always
    stay in trajectories."""
    images: int | None = None
    """Number of frames whose images and points are exported, spread over the run. Default: the keyframes, with those of the map that the
    run started in."""
    texture: Texture | None = None
    """Texture of OBJ and GLB, from the images of the recording or the colours of the map. Default: vertex colours."""
    recording: Path | None = None
    """New path of the recording, if it was moved after the run."""
    out: Path | None = None
    """Folder of the files. Default: export/ in the result folder."""
    overwrite: bool = False
    """Replace files of the same names that are not from an earlier export, or that were changed since."""

    def __call__(self, console: "Console") -> None:
        from idfslam.export.exporter import Exporter
        from idfslam.runs.finished_run import FinishedRun

        out = self.out or self.folder / "export"
        run = FinishedRun(self.folder, moved=self.recording)
        exporter = Exporter(run, out, self.resolution, self.images, self.texture, self.up, self.lost, self.overwrite)
        print(*exporter.write(self.to), sep="\n")
