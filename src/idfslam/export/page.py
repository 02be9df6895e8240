"""A page that shows a run in three dimensions, in any browser: one file that needs no other and no network.

It holds the mesh with a texture from the archive of images, the camera's path, pictures of the keyframes, and the program that shows them
(`page_assets/`).
"""

import base64
import json
from dataclasses import replace
from importlib.resources import files
from typing import Any

import jinja2
import numpy as np
import trimesh
from markupsafe import Markup
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from idfslam.datasets import Dataset
from idfslam.errors import FrameError
from idfslam.export.compact_glb import compact_glb
from idfslam.export.decimation import decimated
from idfslam.export.surface import cleaned, turned
from idfslam.export.texture import texel_size, textured
from idfslam.frame import Status
from idfslam.geometry.even_spacing import evenly_spread
from idfslam.pictures.direction import best_direction
from idfslam.pictures.scraps import without_scraps
from idfslam.pictures.web_picture import data_address
from idfslam.runs.finished_run import FinishedRun
from idfslam.views.image_archive import ImageArchive
from idfslam.views.surface_colour import of_archive, seen_colours

Floats = NDArray[np.float64]

# All of these were chosen by hand, so that the page of a room has less than 30 MB.
_FACES = 100_000  # of the mesh with a texture. More: finer shapes, a larger page
_COLOURED_FACES = 400_000  # of a mesh with vertex colours, likewise
_TEXELS = 3_000_000  # of the texture, about. More: a sharper and larger page that takes longer to write
_IMAGES = 60  # of the archive that colour it, spread over the run. More: fewer places without an image, more time
_PICTURES = 120  # keyframes with pictures. More: a larger page
_WIDTH = 480  # [px] of a picture. More: sharper, a larger page
_QUALITY = 80  # [1] of 100, of a picture as WebP. More: a larger page
_POSES = 5000  # of the path. More: a smoother path of a long run, a larger page
_OUTLIERS = 0.5  # [percent] of the vertices at each end that do not count for the size of the room. More: the room is shown larger
_THREE = np.diag([1.0, -1.0, -1.0])  # turns a camera that looks along +z, y down, into one that looks along -z, y up

# From the best to the worst: name, colour on the page, meaning
_STATUSES: dict[Status, tuple[str, str]] = {
    Status.OK: ("#2f7de1", "the pose was found"),
    Status.DEGENERATE: ("#12a594", "depth alone does not say where the camera is; images or the last motion helped"),
    Status.DOUBTFUL: ("#e0a030", "the images did not agree well with the map; the pose may be off"),
    Status.INTERPOLATED: ("#8b3fc4", "the camera was lost and found again; the pose lies between known ones"),
    Status.LOST: ("#d1495b", "no image gave a pose; the last motion was carried on"),
}


def page_of(run: FinishedRun, mesh: trimesh.Trimesh, T_ew: Floats, *, name: str, recording: Dataset | None = None) -> str:
    """The page of a run as HTML.

    mesh: of the run, in its world, as `page_mesh` makes it. T_ew (4, 4): from there into axes with y up. recording: that of the run; None:
    pictures come from the archive alone.
    """
    shown = turned(mesh, T_ew)
    return _template().render(
        name=name,
        run=_json(_content(run, shown, T_ew, recording)),
        mesh=Markup(base64.b64encode(compact_glb(shown)).decode()),
        three=Markup(_asset("three.min.js")),
        script=Markup(_asset("page.js")),
    )


def _template() -> jinja2.Template:
    environment = jinja2.Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined)
    return environment.from_string(_asset("page.html"))


def _asset(name: str) -> str:
    return files("idfslam.export").joinpath("page_assets").joinpath(name).read_text(encoding="utf-8")


def _json(values: Any) -> Markup:
    """JSON that ends no element of the page."""
    return Markup(json.dumps(values, separators=(",", ":")).replace("<", "\\u003c"))


def page_mesh(run: FinishedRun, mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The mesh of a run without scraps, in few triangles with a texture, or with vertex colours if the run kept no images."""
    mesh = without_scraps(cleaned(mesh))
    archive = None if run.archive is None else _some(run.archive)
    small = decimated(mesh, _COLOURED_FACES if archive is None else _FACES)
    if archive is None:
        small.visual.vertex_colors = _nearest_colours(mesh, small.vertices)  # type: ignore[union-attr]
        return small

    def shade(points: NDArray[np.float32], normals: NDArray[np.float32]) -> NDArray[np.float32]:
        colours, seen = seen_colours(points, normals, lambda: of_archive(archive))
        colours[~seen] = _nearest_colours(mesh, points[~seen]) / np.float32(255)
        return colours

    return textured(small, shade, texel_size(small.area, _TEXELS))


def _some(archive: ImageArchive) -> ImageArchive:
    """At most _IMAGES of an archive."""
    chosen = evenly_spread(len(archive.views), _IMAGES)
    return replace(archive, views=[archive.views[i] for i in chosen], T_wc=archive.T_wc[chosen], exposures=archive.exposures[chosen])


def _nearest_colours(mesh: trimesh.Trimesh, points: NDArray[np.floating]) -> NDArray[np.uint8]:
    """The colours (N, 3) of the vertices nearest to points (N, 3)."""
    visual: Any = mesh.visual
    return np.asarray(visual.vertex_colors)[cKDTree(mesh.vertices).query(points, workers=-1)[1], :3]


def _content(run: FinishedRun, mesh: trimesh.Trimesh, T_ew: Floats, recording: Dataset | None) -> dict[str, Any]:
    """What the page shows beside the mesh, for page.js. A pose is a list x, y, z, qx, qy, qz, qw of a camera that looks along -z, y up."""
    severity, stamps = list(_STATUSES), run.trajectory.timestamps
    codes = np.array([severity.index(status) for status in run.statuses])
    first = np.unique(np.linspace(0, len(stamps), min(len(stamps), _POSES), endpoint=False).astype(int))
    seconds = float(stamps[-1] - stamps[0])
    low, high = _extent(mesh, T_ew @ run.trajectory.poses)
    keyframes, camera = run.keyframes, run.keyframes.camera
    pictured = set(keyframes.indices[evenly_spread(len(keyframes.indices), _PICTURES)].tolist())
    return {
        "path": _poses(run.trajectory.poses[first], T_ew),
        "frames": first.tolist(),
        "status": np.maximum.reduceat(codes, first).tolist(),  # of several frames the worst
        "statuses": [{"name": status.value, "colour": colour, "meaning": meaning} for status, (colour, meaning) in _STATUSES.items()],
        "perSecond": (len(first) - 1) / seconds if seconds > 0 else 30.0,
        "camera": {key: getattr(camera, key) for key in ("width", "height", "fx", "fy", "cx", "cy")},
        "keyframes": [
            {"frame": int(i), "pose": pose, "picture": _picture(run, recording, int(i)) if int(i) in pictured else None}
            for i, pose in zip(keyframes.indices, _poses(keyframes.poses, T_ew))
        ],
        "low": low.round(3).tolist(),
        "high": high.round(3).tolist(),
        "side": best_direction(mesh, (T_ew @ run.trajectory.poses)[:, :3, 3], np.array([0.0, 1.0, 0.0])).round(3).tolist(),
    }


def _extent(mesh: trimesh.Trimesh, T_ec: Floats) -> tuple[Floats, Floats]:
    """The least and largest coordinates (3,) of a room and of the cameras (N, 4, 4) in it."""
    room = np.percentile(mesh.vertices, [_OUTLIERS, 100 - _OUTLIERS], axis=0)
    both = np.concatenate([room, T_ec[:, :3, 3]])
    return both.min(0), both.max(0)


def _poses(T_wc: Floats, T_ew: Floats) -> list[list[float]]:
    T = T_ew @ T_wc
    turns = Rotation.from_matrix(T[:, :3, :3] @ _THREE).as_quat() if len(T) else np.empty((0, 4))
    return [[*place, *turn] for place, turn in zip(T[:, :3, 3].round(4).tolist(), turns.round(5).tolist())]


def _picture(run: FinishedRun, recording: Dataset | None, index: int) -> str | None:
    """A frame's picture as the address of its own data: from the recording, or from the archive; None if neither has it."""
    colour = None
    if recording is not None:
        try:
            colour = np.round(recording[index].colour * 255).astype(np.uint8)
        except FrameError:
            colour = None
    if colour is None and run.archive is not None:
        kept = [k for k, view in enumerate(run.archive.views) if view.index == index]
        colour = run.archive.colour(kept[0]) if kept else None
    return None if colour is None else data_address(colour, _QUALITY, largest=_WIDTH)
