"""Makes pictures and videos from a saved map."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track

from idfslam.errors import ConfigError, ResultError
from idfslam.evaluation.evaluate import load_mesh
from idfslam.geometry.camera import Camera
from idfslam.geometry.level import up_direction
from idfslam.pictures.camera_paths import fly_through, load_poses, orbit
from idfslam.pictures.image_files import write_colour, write_depth
from idfslam.pictures.video import write_video
from idfslam.runs import result_folder
from idfslam.runs.finished_run import FinishedRun
from idfslam.storage import atomic_files, output_folder
from idfslam.storage.ledger import Ledger

Item = TypeVar("Item")
_NARROWEST, _WIDEST = 16, 16384  # [px] widths of pictures; a wider one takes more than 4 GB of memory. Chosen by hand
_ORBIT = 0.08  # radius of an orbit as a share of the room's size; larger: more parallax, nearer to the walls


@dataclass(frozen=True, eq=False)
class ViewPoints:
    """The poses and the camera that a map is rendered from."""

    names: Sequence[str]  # of the pictures
    poses: NDArray[np.float64]  # (N, 4, 4) T_wc
    camera: Camera


def view_points(run: FinishedRun, *, frames: Sequence[int] = (), poses: Path | None = None, width: int | None = None) -> ViewPoints:
    """The view points of frames of the trajectory (none: the keyframes), or of the poses in a file.

    The camera is the file's if it has one, else the run's, resized to `width` [px].
    Raises ConfigError for a frame outside the trajectory or a width below 16, ResultError if there is no pose at all.
    """
    camera, trajectory = run.keyframes.camera, run.trajectory.poses
    if poses is not None:
        if frames:
            raise ConfigError("--frames and --poses: choose one of them")
        found, own = load_poses(poses)
        names = [f"{i:06d}" for i in range(len(found))]
        camera = own or camera
    else:
        chosen = list(frames) or run.keyframes.indices.tolist()
        for i in chosen:
            if not 0 <= i < len(trajectory):
                raise ConfigError(f"--frames {i}: the trajectory has frames 0 to {len(trajectory) - 1}")
        found, names = trajectory[chosen], [f"{i:06d}" for i in chosen]
    if not len(found):
        raise ResultError(f"{poses}: no poses in it" if poses else f"{run.folder}: the run has no keyframes; choose frames with --frames")
    if width is not None:
        if not _NARROWEST <= width <= _WIDEST:
            raise ConfigError(f"--width {width}, expected {_NARROWEST} to {_WIDEST} pixels")
        camera = camera.resized(width, max(1, round(width * camera.height / camera.width)))
    return ViewPoints(names, found, camera)


def write_views(
    run: FinishedRun, points: ViewPoints, out: Path | None = None, *, of_map: bool = False, console: Console | None = None
) -> list[Path]:
    """Renders colour (8 bit) and depth (16 bit, mm) from the view points to PNG files. Returns their paths.

    of_map: the map's own colour is shown instead of the archive's images. console: where a progress bar is shown.
    Raises ResultError if the run has no map, or if another's picture would be replaced.
    """
    target, renderer = out or run.folder / "render", run.map if of_map else run.views
    ledger = Ledger(target)
    ledger.refuse_foreign([f"{name}-{kind}.png" for name in points.names for kind in ("colour", "depth")])
    atomic_files.prepare(target)
    paths = []
    for name, T_wc in _bar(list(zip(points.names, points.poses)), console):
        colour, depth = renderer.render(T_wc, points.camera)
        pair = [target / f"{name}-colour.png", target / f"{name}-depth.png"]
        write_colour(pair[0], np.asarray(colour))
        write_depth(pair[1], np.asarray(depth))
        ledger.record([path.name for path in pair])
        paths += pair
    return paths


def write_flight(
    run: FinishedRun,
    path: Path,
    kind: Literal["along", "orbit"],
    *,
    poses: NDArray[np.float64],
    camera: Camera,
    seconds: float,
    fps: float,
    of_map: bool = False,
    overwrite: bool = False,
    console: Console | None = None,
) -> Path:
    """Renders a video of the map: a smooth flight along T_wc (N, 4, 4), or an orbit in the middle of the room. Returns `path`.

    of_map: the map's own colour is shown instead of the archive's images. overwrite: a video that is there already is replaced; one that
    the program wrote into the result folder always is. console: where a progress bar is shown.
    Raises ConfigError for an invalid length or frame rate, ResultError if the file exists.
    """
    frames = round(seconds * fps) if 0 < seconds < np.inf and 0 < fps <= 240 else 0
    if frames < 2:
        raise ConfigError(f"--seconds {seconds} at --fps {fps}, expected a video of two frames or more, at most 240 a second")
    flight = fly_through(poses, frames, fps=fps) if kind == "along" else _orbit(run, poses, frames)
    own = path.parent == run.folder and Ledger(run.folder).owns(path.name)
    if not own and not overwrite:
        output_folder.refuse_existing(path)
    renderer = run.map if of_map else run.views
    atomic_files.prepare(path.parent)

    def images() -> Iterator[NDArray[np.uint8]]:
        for T_wc in _bar(list(flight), console):
            yield (np.clip(renderer.render(T_wc, camera)[0], 0, 1) * 255 + 0.5).astype(np.uint8)

    with atomic_files.replacing(path) as part:
        write_video(part, images(), fps=fps)
    if path.parent == run.folder:
        result_folder.ledger(run.folder).record([path.name])
    return path


def _bar(views: Sequence[Item], console: Console | None) -> Iterable[Item]:
    return track(views, "views", console=console, disable=console is None)


def _orbit(run: FinishedRun, poses: NDArray[np.float64], frames: int) -> NDArray[np.float64]:
    """An orbit around the mean camera position, inside the room."""
    mesh = load_mesh(result_folder.existing(run.folder, result_folder.MESH))
    size = float(np.ptp(np.percentile(mesh.vertices, [2, 98], axis=0), axis=0).max())
    return orbit(poses, frames, up=up_direction(mesh, poses), centre=poses[:, :3, 3].mean(0), radius=_ORBIT * size)
