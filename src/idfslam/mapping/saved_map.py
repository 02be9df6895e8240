"""A map in one file: the field's weights, the fused volume, and the depth of views, which restricts meshes to observed surface."""

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
import trimesh
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from idfslam.config import dump, update
from idfslam.errors import ConfigError, ResultError
from idfslam.fusion.tsdf_volume import TsdfVolume
from idfslam.fusion.volume_codec import tensors_of, volume_of
from idfslam.geometry.camera import Camera, indices_by_camera
from idfslam.geometry.depth_view import DepthView, reduced_view
from idfslam.mapping.field import Field, grids_of, load_field
from idfslam.mapping.fields import FIELDS, make_field
from idfslam.mapping.implicit_surface import ImplicitSurface
from idfslam.mapping.meshing import extract_mesh, observed
from idfslam.mapping.sphere_tracing import trace_image
from idfslam.mapping.surface_field import SurfaceField
from idfslam.storage.safetensors_file import ordered

FORMAT = 3  # format of the file, counted up with each change that older versions cannot read
_ONE_CAMERA = 2  # the format before, in which all views have one camera: a fact of older files
# [m] Largest distance of rendered surface from a reading to count as observed, added to 0.3 tr: as in a mesh of 2 cm. More: surfaces
# extend beyond what was seen.
_OBSERVED = 0.03
_SLANT = 1.4  # [1] length of a ray at an image's corner over its depth. More: rays are traced farther
_VIEW_ROWS = 60  # [px] rows of the depth images in the file. More: finer outlines of the observed surface, fewer views. Chosen by hand
_VIEW_BYTES = 1_200_000  # [bytes] of all depth images. More: more views. With the largest feature grid the file stays below 10 MB


@dataclass(frozen=True)
class SavedMap:
    """A field, the views that it was learnt from, and the volume that these were fused into."""

    field: SurfaceField
    views: Sequence[DepthView]
    volume: TsdfVolume | None = None  # None: the surface is the field's alone

    @property
    def surface(self) -> ImplicitSurface:
        """The map's signed distance."""
        return ImplicitSurface(self.field, self.volume)

    def mesh(self, resolution: float) -> trimesh.Trimesh:
        """The observed surface in cells of `resolution` [m], with vertex colours."""
        return mesh_of(self.surface, self.views, resolution)

    def render(self, T_wc: NDArray[np.float64], camera: Camera) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Colour (H, W, 3) and depth (H, W) [m] of the map for a camera at `T_wc` (4, 4). Only observed surface is rendered."""
        farthest = _reach(self.views, T_wc) + 2 * self.field.config.truncation
        tolerance = _OBSERVED + 0.3 * self.field.config.truncation

        def seen(points: Tensor) -> Tensor:
            return torch.from_numpy(observed(points.cpu().double().numpy(), self.views, tolerance)).to(points.device)

        image = trace_image(
            self.surface.sdf,
            lambda points, directions: self.field(points, directions)[1],
            torch.from_numpy(T_wc).float().to(next(self.field.parameters()).device),
            camera,
            far=farthest,
            truncation=self.field.config.truncation,
            observed=seen,
            tracer=self.surface.tracer(),
        )
        return image.colour.cpu().numpy(), image.depth.cpu().numpy()


def _reach(views: Sequence[DepthView], T_wc: NDArray[np.float64]) -> float:
    """A bound on the distance [m] of any reading from a camera at `T_wc` (4, 4)."""
    return max(float(view.depth.max()) * _SLANT + float(np.linalg.norm(view.T_wc[:3, 3] - T_wc[:3, 3])) for view in views)


def mesh_of(
    surface: ImplicitSurface, views: Sequence[DepthView], resolution: float, *, finer: Iterable[DepthView] | None = None
) -> trimesh.Trimesh:
    """The surface where the views observed it. Colour that depends on the view direction is that of a head-on view.

    finer: the same views in more rows, if there are such. Where voxels are smaller than `resolution` [m], so are cells that are not flat.
    """
    field, volume = surface.field, surface.volume
    device = next(field.parameters()).device

    def colour(points: Tensor) -> Tensor:
        towards = -field.distance(points)[1] if field.direction_encoding is not None else None
        return field(points, towards)[1]

    refine = surface.refined if volume is not None and volume.voxel < resolution else None
    with torch.no_grad():
        return extract_mesh(
            surface.sdf if refine is None else surface.of_field,
            colour,
            views,
            resolution=resolution,
            truncation=surface.truncation,
            device=device,
            refine=refine,
            finer=finer,
        )


def save_map(path: Path, field: SurfaceField, views: Sequence[DepthView], volume: TsdfVolume | None = None) -> None:
    """Writes a map as one safetensors file. The tables of a feature grid, and depths in millimetres, have 16 bits.

    As many views are written as fit, evenly spread. Those of the i-th camera are `views.i.depth` (V, H, W) and `views.i.T_wc` (V, 4, 4).
    `volume.blocks`, `volume.low`, `volume.high` and `volume.trust` are the volume's (`volume_codec`); a map without a volume lacks them.
    Metadata: `format`, `field`, `cameras` and `volume` (JSON), and `precision` (how numbers are rounded). Equal maps give equal files.
    """
    tensors = {f"field.{name}": value.detach().cpu().contiguous() for name, value in field.state_dict().items()}
    config = field.config
    for name, grid in grids_of(field):
        if isinstance(field, Field):
            config = replace(config, table_log2=grid.tables.shape[1].bit_length() - 1)
        tensors[f"field.{name}.tables"] = tensors[f"field.{name}.tables"].half()
    small = [reduced_view(view.T_wc, view.depth, view.camera, _VIEW_ROWS) for view in views]
    count = min(len(small), max(1, _VIEW_BYTES // (2 * max(view.depth.size for view in small))))
    kept = [small[i] for i in np.linspace(0, len(small) - 1, count).round().astype(int)]
    cameras = indices_by_camera([view.camera for view in kept])
    for i, members in enumerate(cameras.values()):
        depths = np.stack([np.clip(kept[k].depth * 1000 + 0.5, 0, 65535) for k in members]).astype(np.uint16)
        tensors[f"views.{i}.depth"] = torch.from_numpy(depths)
        tensors[f"views.{i}.T_wc"] = torch.from_numpy(np.stack([kept[k].T_wc for k in members]))
    precision = (
        "field.encoding.tables: float16; views.*.depth: uint16 [mm]"
        if isinstance(field, Field)
        else "field.*.tables: float16; views.*.depth: uint16 [mm]"
    )
    metadata = {
        "field": json.dumps(dump(config)),
        "representation": field.representation,
        "cameras": json.dumps([asdict(camera) for camera in cameras]),
        "precision": precision,
    }
    if volume is not None:
        tensors |= {f"volume.{name}": value for name, value in tensors_of(volume).items()}
        metadata["volume"] = json.dumps({"voxel": volume.voxel, "truncation": volume.truncation})
    path.write_bytes(ordered(save(tensors, {"format": str(FORMAT), **metadata})))


def load_map(path: Path) -> SavedMap:
    """Reads a map of this format or of the one before. Raises ResultError if the file is damaged, no map, or of another format."""
    try:
        with safe_open(path, "pt") as file:
            metadata = file.metadata() or {}
            if metadata.get("format") not in (str(FORMAT), str(_ONE_CAMERA)):
                found = metadata.get("format", "none")
                raise ResultError(f"{path}: map format {found}, expected {FORMAT}; use the version of idf-slam that wrote it")
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (safe_open is no mapping)
        representation = metadata.get("representation", Field.representation)  # files of older versions have no other
        field = _field(representation, update(FIELDS[representation][0](), json.loads(metadata["field"]), "its metadata"), tensors)
        return SavedMap(field, _views(metadata, tensors), _volume(metadata, tensors))
    except (OSError, SafetensorError, ConfigError, KeyError, TypeError, ValueError, AttributeError) as error:
        raise ResultError(f"{path}: cannot be read as a map ({type(error).__name__}: {error}); expected a run's map.safetensors") from error


def _field(representation: str, config: Any, tensors: dict[str, Tensor]) -> SurfaceField:
    """The field with its weights. Raises ValueError if the weights do not fit the config."""
    found = {name.removeprefix("field."): value for name, value in tensors.items() if name.startswith("field.")}
    weights = {name: value if value.dtype == torch.bool else value.float() for name, value in found.items()}
    with torch.device("meta"):  # shapes without memory, since a damaged config may have any size
        made = make_field(representation, config)
        expected = {name: tuple(value.shape) for name, value in made.state_dict().items()}
    for name in {*expected, *weights}:
        shape = tuple(weights[name].shape) if name in weights else "missing"
        if shape != expected.get(name, ()) and not _grown(made, name, shape):
            raise ValueError(f"field.{name} is {shape}, expected {expected.get(name, 'none')}")
        if not bool(weights[name].isfinite().all()):
            raise ValueError(f"field.{name} holds numbers that are not finite")
    field = make_field(representation, config)
    load_field(field, weights)
    return field.requires_grad_(False)


def _grown(field: SurfaceField, name: str, shape: Any) -> bool:
    """Whether a shape is that of a table of several levels that has grown by itself, or of the marks of its entries."""
    if isinstance(field, Field) or shape == "missing":
        return False
    entries = {f"{level}.tables": grid.tables.shape for level, grid in grids_of(field)}.get(name)
    size = shape[1] if entries is not None and len(shape) == 3 else shape[0] if name.endswith("_used") and len(shape) == 1 else 0
    fits = entries is None or (shape[0], shape[2]) == (entries[0], entries[2])
    return fits and size > 0 and size & (size - 1) == 0


def _volume(metadata: dict[str, str], tensors: dict[str, Tensor]) -> TsdfVolume | None:
    """The volume; None if the map has none. Raises ValueError or KeyError if its tensors make no volume."""
    if "volume" not in metadata:
        return None
    named = {name.removeprefix("volume."): value for name, value in tensors.items() if name.startswith("volume.")}
    values = json.loads(metadata["volume"])
    return volume_of(named, float(values["voxel"]), float(values["truncation"]))


def _views(metadata: dict[str, str], tensors: dict[str, Tensor]) -> list[DepthView]:
    """The views, grouped by camera. Raises ValueError if there are none, or if they do not fit their camera."""
    if metadata["format"] == str(_ONE_CAMERA):
        return _views_of(Camera(**json.loads(metadata["camera"])), tensors, "views")
    cameras = [Camera(**values) for values in json.loads(metadata["cameras"])]
    if not cameras:
        raise ValueError("it has no views")
    return [view for i, camera in enumerate(cameras) for view in _views_of(camera, tensors, f"views.{i}")]


def _views_of(camera: Camera, tensors: dict[str, Tensor], name: str) -> list[DepthView]:
    """The views of one camera. Raises ValueError if poses, depths and camera do not fit together."""
    poses, depths = tensors[f"{name}.T_wc"].numpy(), tensors[f"{name}.depth"].numpy().astype(np.float32) / 1000
    if len(depths) == 0 or poses.shape != (len(depths), 4, 4) or depths.shape[1:] != (camera.height, camera.width):
        raise ValueError(f"{name}: poses {poses.shape} and depths {depths.shape} of a {camera.width} x {camera.height} camera")
    return [DepthView(pose, depth, camera) for pose, depth in zip(poses, depths)]
