"""`idf-slam render`."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from tyro.conf import Positional

if TYPE_CHECKING:
    from rich.console import Console


@dataclass(frozen=True)
class Render:
    """Render a saved map: colour and depth pictures, or a video."""

    folder: Positional[Path]
    """Result folder."""
    frames: tuple[int, ...] = ()
    """Frames of the trajectory to render. Default: the keyframes."""
    poses: Path | None = None
    """File of camera-to-world poses to render instead: TUM, KITTI, EuRoC's csv, or a transforms.json, whose camera is used too."""
    width: int | None = None
    """Width of the pictures [px]. Default: that of the camera."""
    video: Literal["along", "orbit"] | None = None
    """Render a video: a smooth flight `along` the trajectory (or --poses), or an `orbit` seen from the middle of the room."""
    seconds: float = 10.0
    """Length of the video [s]."""
    fps: float = 30.0
    """Frame rate of the video [1/s]."""
    colour: Literal["images", "map"] = "images"
    """Colours of the `images` that the run kept in its archive, over the map, or those that the `map` has learnt."""
    out: Path | None = None
    """Folder of the pictures, or file of the video (.mp4). Default: render/ or video.mp4 in the result folder."""
    overwrite: bool = False
    """Replace the video that --out names if it exists."""

    def __call__(self, console: "Console") -> None:
        from idfslam.errors import ConfigError
        from idfslam.pictures.map_views import view_points, write_flight, write_views
        from idfslam.runs.finished_run import FinishedRun

        default = Render(self.folder)
        if self.video is None and (self.seconds, self.fps, self.overwrite) != (default.seconds, default.fps, default.overwrite):
            raise ConfigError("--seconds, --fps and --overwrite belong to a video: give --video along or --video orbit as well")
        run = FinishedRun(self.folder)
        points = view_points(run, frames=self.frames, poses=self.poses, width=self.width)
        of_map = self.colour == "map"
        if self.video is None:
            print(*write_views(run, points, self.out, of_map=of_map, console=console), sep="\n")
            return
        path = self.out or self.folder / "video.mp4"
        along = points.poses if self.frames or self.poses else run.trajectory.poses
        times: dict[str, Any] = {"seconds": self.seconds, "fps": self.fps, "of_map": of_map, "overwrite": self.overwrite}
        print(write_flight(run, path, self.video, poses=along, camera=points.camera, **times, console=console))
