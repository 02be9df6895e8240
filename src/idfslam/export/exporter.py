"""Exports a finished run to the formats of other programs, one method for each format."""

import logging
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from idfslam.datasets import Dataset
from idfslam.errors import ConfigError, IdfSlamError, ResultError
from idfslam.export import colmap, memory_need, nerfstudio, tsdf_grid
from idfslam.export.axes import Axes
from idfslam.export.axes_file import RECORD, note_axes
from idfslam.export.exported_frames import posed_images
from idfslam.export.formats import Format, Lost, Texture, Up
from idfslam.export.images import COLOUR, DEPTH, PosedImage, write_images
from idfslam.export.lost_frames import LOST, remarked, write_lost
from idfslam.export.masks import write_masks
from idfslam.export.mesh_files import write_glb, write_obj, write_ply
from idfslam.export.page import page_mesh, page_of
from idfslam.export.point_cloud import PointCloud, fuse
from idfslam.export.run_surface import check_resolution, mesh_of_map, surface_area
from idfslam.export.run_texture import with_texture
from idfslam.export.splats import write_splats
from idfslam.export.surface import turned
from idfslam.geometry.kitti import save_kitti
from idfslam.geometry.trajectory import Trajectory, save_tum
from idfslam.runs import result_folder
from idfslam.runs.finished_run import FinishedRun
from idfslam.storage import atomic_files
from idfslam.storage.ledger import Ledger

log = logging.getLogger(__name__)

_TEXTURED = ("obj", "glb")
_Y_UP = ("glb", "page")  # whatever --up says
_OF_IMAGES = ("nerfstudio", "colmap", "points")
# What a format writes, or may write, in the folder of the export
_TARGETS: dict[Format, tuple[str, ...]] = {
    "tum": ("tum.txt", LOST),
    "kitti": ("kitti.txt", "kitti_times.txt", LOST),
    "nerfstudio": tuple(f"nerfstudio/{name}" for name in (COLOUR, DEPTH, nerfstudio.POINTS, nerfstudio.TRANSFORMS)),
    "colmap": tuple(f"colmap/{name}" for name in (COLOUR, DEPTH, "sparse", LOST)),
    "ply": ("mesh.ply",),
    "obj": ("mesh.obj", "mesh.mtl", "mesh.png"),
    "glb": ("mesh.glb",),
    "points": ("points.ply",),
    "splats": ("splats.ply",),
    "page": (result_folder.SCENE,),
    "masks": ("masks",),
    "grid": ("grid.npz",),
    "blocks": ("blocks.npz",),
}


@dataclass(frozen=True, eq=False)
class Exporter:
    """Writes exports to `out`. Raises ResultError or RecordingError if a format needs a file of the run that is missing."""

    run: FinishedRun
    out: Path
    resolution: float = 0.02  # [m] cells of meshes and grids, spacing of points
    images: int | None = None  # number of frames that give images and points; None: the keyframes
    texture: Texture | None = None
    up: Up = "z"
    lost: Lost | None = None  # frames whose pose was not measured; None: they are in trajectories and have no images
    overwrite: bool = False  # files of the same names that no export wrote are replaced

    def write(self, formats: Sequence[Format]) -> list[Path]:
        """Writes the formats and transform.json. Returns the formats' files, or the folder for a format of many files.

        Raises ConfigError for wrong options, ResultError if a file of the user's own would be replaced.
        """
        check_resolution(self.resolution)
        if not formats:
            raise ConfigError(f"--to: expected at least one of {', '.join(_TARGETS)}")
        if self.texture and not set(formats) & set(_TEXTURED):
            raise ConfigError(f"--texture with --to {' '.join(formats)}: none of these has textures; choose {' or '.join(_TEXTURED)}")
        if self.images is not None and not (set(formats) & set(_OF_IMAGES) or self.texture == "images"):
            raise ConfigError(f"--images with --to {' '.join(formats)}: none of these has images; choose {', '.join(_OF_IMAGES)}")
        atomic_files.prepare(self.out)
        writers: dict[Format, Callable[[], list[Path]]] = {
            "tum": self._tum, "kitti": self._kitti, "nerfstudio": self._nerfstudio, "colmap": self._colmap, "ply": self._ply,
            "obj": self._obj, "glb": self._glb, "points": self._points, "splats": self._splats, "page": self._page, "masks": self._masks,
            "grid": self._grid, "blocks": self._blocks,
        }  # fmt: skip
        ledger = self._ledger(formats)
        paths: list[Path] = []
        for to in dict.fromkeys(formats):
            written = writers[to]()
            ledger.record(_existing(self.out, _TARGETS[to] if written[0].is_dir() else [path.name for path in written]))
            note_axes(ledger, to, self._axes.gltf if to in _Y_UP else self._axes, newest=self._axes)
            paths += written
        self._axes.warn_if_not_level()
        return list(dict.fromkeys(paths))

    def _ledger(self, formats: Sequence[Format]) -> Ledger:
        """The ledger of the folder. Raises ResultError if the formats would replace a file of the user's own or of the run."""
        ledger, targets = result_folder.ledger(self.out), [name for to in formats for name in _TARGETS[to]]
        if self.out.resolve() == self.run.folder.resolve() and set(targets) & set(result_folder.FILES):
            raise ResultError(f"{self.out}: its {result_folder.MESH} would be replaced; choose another folder with --out")
        if not self.overwrite:
            advice = "choose another folder with --out, or replace it with --overwrite"
            ledger.refuse_foreign(_existing(self.out, [*targets, RECORD]), advice=advice)
        return ledger

    @cached_property
    def _axes(self) -> Axes:
        return Axes.of(self.run, self.up)

    @cached_property
    def _frames(self) -> NDArray[np.int64]:
        """The frames of exported trajectories."""
        kept = self.run.measured if self.lost == "drop" else np.full(len(self.run.trajectory), True)
        if not kept.any():
            raise ResultError(f"{self.run.folder}: the run has no frame whose pose was measured; expected one with --lost drop")
        return np.flatnonzero(kept)

    @property
    def _trajectory(self) -> Trajectory:
        return Trajectory(self.run.trajectory.timestamps[self._frames], self._axes.T_ew @ self.run.trajectory.poses[self._frames])

    def _lost_frames(self) -> list[Path]:
        """lost.txt beside a trajectory: all frames whose pose was not measured or is in doubt, whether they are in it or not."""
        stamps, statuses = self.run.trajectory.timestamps, self.run.statuses
        return write_lost(self.out, "frame timestamp", ((f"{i} {stamps[i]:.6f}", statuses[i]) for i in np.flatnonzero(~self.run.trusted)))

    def _tum(self) -> list[Path]:
        with atomic_files.replacing(self.out / "tum.txt") as part:
            save_tum(part, self._trajectory)
            part.write_text(remarked(part.read_text(encoding="utf-8"), [self.run.statuses[i] for i in self._frames]))
        return [self.out / "tum.txt", *self._lost_frames()]

    def _kitti(self) -> list[Path]:
        paths = [self.out / "kitti.txt", self.out / "kitti_times.txt"]
        with atomic_files.replacing(paths[0]) as part:
            save_kitti(part, self._trajectory.poses)
        with atomic_files.replacing(paths[1]) as part:
            np.savetxt(part, self._trajectory.timestamps, fmt="%.6f")
        return [*paths, *self._lost_frames()]

    def _nerfstudio(self) -> list[Path]:
        folder = self.out / "nerfstudio"
        images = write_images(folder, self._posed_images())
        with atomic_files.replacing(folder / nerfstudio.POINTS) as part:
            self._cloud(images).save(part)
        nerfstudio.write_transforms(folder / nerfstudio.TRANSFORMS, images)
        return [folder]

    def _colmap(self) -> list[Path]:
        folder = self.out / "colmap"
        images = write_images(folder, self._posed_images())
        colmap.write_colmap(folder / "sparse" / "0", images, self._cloud(images))
        write_lost(folder, "image", ((image.name, image.status) for image in images if not image.status.trusted))
        return [folder]

    def _ply(self) -> list[Path]:
        return write_ply(self.out / "mesh.ply", turned(self._mesh, self._axes.T_ew))

    def _obj(self) -> list[Path]:
        return write_obj(self.out / "mesh.obj", turned(self._textured, self._axes.T_ew))

    def _glb(self) -> list[Path]:
        return write_glb(self.out / "mesh.glb", turned(self._textured, self._axes.gltf.T_ew))

    def _points(self) -> list[Path]:
        with atomic_files.replacing(self.out / "points.ply") as part:
            self._cloud(self._posed_images()).save(part)
        return [self.out / "points.ply"]

    def _splats(self) -> list[Path]:
        return write_splats(self.out / "splats.ply", turned(self._mesh, self._axes.T_ew), self.resolution)

    def _page(self) -> list[Path]:
        path, T_ew, mesh = self.out / result_folder.SCENE, self._axes.gltf.T_ew, page_mesh(self.run, self._mesh)
        page = page_of(self.run, mesh, T_ew, name=self.run.folder.resolve().name, recording=self._recording)
        with atomic_files.replacing(path) as part:
            part.write_text(page, encoding="utf-8")
        return [path]

    def _masks(self) -> list[Path]:
        return [write_masks(self.out / "masks", self.run)]

    @property
    def _recording(self) -> Dataset | None:
        """The recording; None if it cannot be read, which is told."""
        try:
            return self.run.recording
        except IdfSlamError as error:
            log.warning("%s; pictures come from the archive of images alone", error)
            return None

    def _grid(self) -> list[Path]:
        with atomic_files.replacing(self.out / "grid.npz") as part:
            tsdf_grid.save_grid(part, self.run.map, self.resolution, self._axes.T_ew)
        return [self.out / "grid.npz"]

    def _blocks(self) -> list[Path]:
        memory_need.check_blocks(surface_area(self.run), self.run.map.field.config.truncation, self.resolution)
        with atomic_files.replacing(self.out / "blocks.npz") as part:
            tsdf_grid.save_blocks(part, self.run.map, self.resolution, self._axes.T_ew)
        return [self.out / "blocks.npz"]

    def _posed_images(self) -> Iterator[PosedImage]:
        """The exported images in the axes of the exports; with --lost keep those whose pose is not trusted as well."""
        images = posed_images(self.run, self.images, guessed=self.lost == "keep")
        return (replace(image, T_wc=self._axes.T_ew @ image.T_wc) for image in images)

    def _cloud(self, images: Iterable[PosedImage]) -> PointCloud:
        """The points of the images whose pose is trusted, in the axes of the images' poses."""
        return fuse(((image.frame, image.T_wc) for image in images if image.status.trusted), self.resolution)

    @cached_property
    def _mesh(self) -> trimesh.Trimesh:
        """In the run's world."""
        return mesh_of_map(self.run, self.resolution)

    @cached_property
    def _textured(self) -> trimesh.Trimesh:
        """The mesh, with a texture if one is chosen."""
        if self.texture is None:
            return self._mesh
        of_recording = self.images is not None or self.run.archive is None
        return with_texture(self._mesh, self.run, self.texture, partial(posed_images, self.run, self.images) if of_recording else None)


def _existing(folder: Path, names: Iterable[str]) -> list[str]:
    """The files of these names, and those in folders of these names, relative to `folder`."""
    paths = (path for name in names for path in (folder / name, *(folder / name).rglob("*")))
    return [path.relative_to(folder).as_posix() for path in paths if os.path.lexists(path) and not path.is_dir()]
