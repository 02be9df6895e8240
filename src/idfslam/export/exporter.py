"""Exports a finished run to the formats of other programs, one method for each format."""

import itertools
import logging
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import torch
import trimesh

from idfslam.errors import ConfigError, FrameError, RecordingError
from idfslam.export import colmap, nerfstudio, tsdf_grid
from idfslam.export.formats import Format, Texture
from idfslam.export.images import PosedImage, write_images
from idfslam.export.mesh_files import write_glb, write_obj, write_ply
from idfslam.export.point_cloud import PointCloud, fuse
from idfslam.export.texture import Floats, from_images, textured
from idfslam.geometry.kitti import save_kitti
from idfslam.geometry.trajectory import save_tum
from idfslam.runs.finished_run import FinishedRun
from idfslam.runs.prior_map import earlier_keyframes
from idfslam.storage import atomic_files

log = logging.getLogger(__name__)

_TEXTURED = ("obj", "glb")


@dataclass(frozen=True, eq=False)
class Exporter:
    """Writes exports to `out`. Raises ResultError or RecordingError if a format needs a file of the run that is missing."""

    run: FinishedRun
    out: Path
    resolution: float = 0.02  # [m] cells of meshes and grids, spacing of points
    images: int | None = None  # number of frames that give images and points; None: the keyframes
    texture: Texture | None = None

    def write(self, formats: Sequence[Format]) -> list[Path]:
        """Writes the formats. Returns the files, or the folder for a format of many files."""
        if not 0 < self.resolution < np.inf:
            raise ConfigError(f"--resolution {self.resolution}, expected metres above 0, such as 0.02")
        if self.texture and not set(formats) & set(_TEXTURED):
            raise ConfigError(f"--texture with --to {' '.join(formats)}: none of these has textures; choose {' or '.join(_TEXTURED)}")
        atomic_files.prepare(self.out)
        writers: dict[Format, Callable[[], list[Path]]] = {
            "tum": self._tum, "kitti": self._kitti, "nerfstudio": self._nerfstudio, "colmap": self._colmap, "ply": self._ply,
            "obj": self._obj, "glb": self._glb, "points": self._points, "grid": self._grid, "blocks": self._blocks,
        }  # fmt: skip
        return [path for name in dict.fromkeys(formats) for path in writers[name]()]

    def _tum(self) -> list[Path]:
        with atomic_files.replacing(self.out / "tum.txt") as part:
            save_tum(part, self.run.trajectory)
        return [self.out / "tum.txt"]

    def _kitti(self) -> list[Path]:
        paths = [self.out / "kitti.txt", self.out / "kitti_times.txt"]
        with atomic_files.replacing(paths[0]) as part:
            save_kitti(part, self.run.trajectory.poses)
        with atomic_files.replacing(paths[1]) as part:
            np.savetxt(part, self.run.trajectory.timestamps, fmt="%.6f")
        return paths

    def _nerfstudio(self) -> list[Path]:
        folder = self.out / "nerfstudio"
        images = write_images(folder, self._images())
        with atomic_files.replacing(folder / nerfstudio.POINTS) as part:
            _cloud(images, self.resolution).save(part)
        nerfstudio.write_transforms(folder / nerfstudio.TRANSFORMS, images)
        return [folder]

    def _colmap(self) -> list[Path]:
        folder = self.out / "colmap"
        images = write_images(folder, self._images())
        colmap.write_colmap(folder / "sparse" / "0", images, _cloud(images, self.resolution))
        return [folder]

    def _ply(self) -> list[Path]:
        return write_ply(self.out / "mesh.ply", self._mesh)

    def _obj(self) -> list[Path]:
        return write_obj(self.out / "mesh.obj", self._textured)

    def _glb(self) -> list[Path]:
        return write_glb(self.out / "mesh.glb", self._textured)

    def _points(self) -> list[Path]:
        with atomic_files.replacing(self.out / "points.ply") as part:
            _cloud(self._images(), self.resolution).save(part)
        return [self.out / "points.ply"]

    def _grid(self) -> list[Path]:
        with atomic_files.replacing(self.out / "grid.npz") as part:
            tsdf_grid.save_grid(part, self.run.map, self.resolution)
        return [self.out / "grid.npz"]

    def _blocks(self) -> list[Path]:
        with atomic_files.replacing(self.out / "blocks.npz") as part:
            tsdf_grid.save_blocks(part, self.run.map, self.resolution)
        return [self.out / "blocks.npz"]

    def _images(self) -> Iterator[PosedImage]:
        """The exported frames: the keyframes of the map that the run started in, then frames of the run's own recording.

        An unreadable frame is reported and left out. Raises RecordingError if none is left.
        """
        found = False
        for image in itertools.chain(self._earlier_images(), self._own_images()):
            found = True
            yield image
        if not found:
            raise RecordingError(f"{self.run.folder}: none of the frames to export can be read")

    def _earlier_images(self) -> Iterator[PosedImage]:
        if self.images is None:
            for i, keyframe in enumerate(earlier_keyframes(self.run.keyframes.earlier)):
                yield PosedImage(f"earlier_{i:06d}.png", keyframe.T_wk.numpy(), keyframe.frame)

    def _own_images(self) -> Iterator[PosedImage]:
        if self.images is None and self.run.keyframes.earlier and not len(self.run.keyframes.indices):
            return  # the map that the run started in needed no keyframe of it
        for i in map(int, self.run.frames_to_show(self.images)):
            try:
                yield PosedImage(f"{i:06d}.png", self.run.trajectory.poses[i], self.run.recording[i])
            except FrameError as error:
                log.warning("%s; the frame is left out", error)

    @cached_property
    def _mesh(self) -> trimesh.Trimesh:
        return self.run.map.mesh(self.resolution)

    @cached_property
    def _textured(self) -> trimesh.Trimesh:
        """The mesh, with a texture if one is chosen."""
        if self.texture is None:
            return self._mesh
        if self.texture == "map":
            return textured(self._mesh, self._map_colour)
        return textured(self._mesh, from_images(((image.frame, image.T_wc) for image in self._images()), self._map_colour))

    @torch.no_grad()
    def _map_colour(self, points: Floats, normals: Floats) -> Floats:
        """The map's colour of points, seen along their normals."""
        field = self.run.map.field
        device = next(field.parameters()).device
        chunks = (torch.from_numpy(np.ascontiguousarray(array)).to(device).split(1 << 18) for array in (points, -normals))
        directed = field.direction_encoding is not None
        return torch.cat([field(p, d if directed else None)[1].cpu() for p, d in zip(*chunks)]).numpy()


def _cloud(images: Iterable[PosedImage], spacing: float) -> PointCloud:
    return fuse(((image.frame, image.T_wc) for image in images), spacing)
