"""`idf-slam render`."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tyro.conf import Positional

if TYPE_CHECKING:
    from rich.console import Console


@dataclass(frozen=True)
class Render:
    """Views of a saved map: colour and depth pictures from frames or any other poses, or a video."""

    folder: Positional[Path]
    """The result folder."""
    frames: tuple[int, ...] = ()
    """Which frames of the trajectory; none given: the keyframes."""
    poses: Path | None = None
    """Camera-to-world poses to look from instead: a file in TUM or KITTI format, or a transforms.json, whose camera is then taken."""
    width: int | None = None
    """Of the pictures [px]; none given: the camera's own."""
    video: Literal["along", "orbit"] | None = None
    """A video instead of pictures: a smooth flight along the trajectory (or --poses), or once around from the middle of the room."""
    seconds: float = 10.0
    """Length of the video."""
    fps: float = 30.0
    """Frames a second of the video."""
    out: Path | None = None
    """Where the pictures go, or the video (.mp4); none given: render/ or video.mp4 in the result folder."""

    def __call__(self, console: "Console") -> None:
        from idfslam.pictures.map_views import view_points, write_flight, write_views
        from idfslam.runs.finished_run import FinishedRun

        run = FinishedRun(self.folder)
        points = view_points(run, frames=self.frames, poses=self.poses, width=self.width)
        if self.video is None:
            print(*write_views(run, points, self.out, console=console), sep="\n")
            return
        path = self.out or self.folder / "video.mp4"
        along = points.poses if self.frames or self.poses else run.trajectory.poses
        times = {"seconds": self.seconds, "fps": self.fps}
        print(write_flight(run, path, self.video, poses=along, camera=points.camera, **times, console=console))
