"""A map in one file: the field's weights, and what the recording saw, so that meshes keep to observed surface."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
import trimesh
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file

from idfslam.config import FieldConfig
from idfslam.errors import ResultError
from idfslam.geometry.camera import Camera
from idfslam.mapping.field import Field
from idfslam.mapping.fused import colour_function, sdf_function
from idfslam.mapping.grid import GridEncoding
from idfslam.mapping.meshing import View, extract_mesh, reduced_view
from idfslam.mapping.rendering import RayMarch, render_image

FORMAT = 1
_MOST_VIEWS = 150  # kept in the file, so that it stays below 10 MB
_SAMPLES, _IMPORTANCE_SAMPLES, _SHARPNESS = 128, 16, 20.0  # of rendered images


@dataclass(frozen=True)
class SavedMap:
    """A field with the views that taught it."""

    field: Field
    views: Sequence[View]

    def mesh(self, resolution: float) -> trimesh.Trimesh:
        """The observed surface in cells of `resolution` [m], with vertex colours."""
        return mesh_of(self.field, self.views, resolution)

    def render(self, T_wc: NDArray[np.float64], camera: Camera) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Colour (H, W, 3) and depth (H, W) [m] that the map shows a camera at `T_wc` (4, 4)."""
        farthest = max(float(view.depth.max()) for view in self.views) + 2 * self.field.config.truncation
        march = RayMarch(_SAMPLES, _IMPORTANCE_SAMPLES, self.field.config.truncation, _SHARPNESS)
        device = next(self.field.parameters()).device
        image = render_image(self.field, torch.from_numpy(T_wc).float().to(device), camera, farthest, march)
        return image.colour.cpu().numpy(), image.depth.cpu().numpy()


def mesh_of(field: Field, views: Sequence[View], resolution: float) -> trimesh.Trimesh:
    """The zero level of a field where the views observed it."""
    device = next(field.parameters()).device
    with torch.no_grad():
        return extract_mesh(
            sdf_function(field), colour_function(field), views, resolution=resolution, truncation=field.config.truncation, device=device
        )


def save_map(path: Path, field: Field, views: Sequence[View]) -> None:
    """One safetensors file; the tables of a feature grid, and depths in millimetres, take 16 bits."""
    tensors = {f"field.{name}": value.detach().cpu().contiguous() for name, value in field.state_dict().items()}
    if isinstance(field.encoding, GridEncoding):
        tensors["field.encoding.tables"] = tensors["field.encoding.tables"].half()
    kept = [views[i] for i in np.unique(np.linspace(0, len(views) - 1, min(len(views), _MOST_VIEWS)).round().astype(int))]
    small = [reduced_view(view.T_wc, view.depth, view.camera, 60) for view in kept]
    depths = np.stack([np.clip(view.depth * 1000 + 0.5, 0, 65535) for view in small]).astype(np.uint16)
    tensors["views.depth"] = torch.from_numpy(depths)
    tensors["views.T_wc"] = torch.from_numpy(np.stack([view.T_wc for view in small]))
    metadata = {"format": str(FORMAT), "field": json.dumps(asdict(field.config)), "camera": json.dumps(asdict(small[0].camera))}
    save_file(tensors, path, metadata)


def load_map(path: Path) -> SavedMap:
    """A saved map. Raises ResultError for a file that is damaged, no map, or of another format version."""
    try:
        with safe_open(path, "pt") as file:
            metadata = file.metadata() or {}
            if metadata.get("format") != str(FORMAT):
                found = metadata.get("format", "none")
                raise ResultError(f"{path}: map format {found}, expected {FORMAT}; use the version of idf-slam that wrote it")
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (safe_open is no mapping)
        config, camera = FieldConfig(**json.loads(metadata["field"])), Camera(**json.loads(metadata["camera"]))
        field = Field(config)
        if isinstance(field.encoding, GridEncoding):
            field.encoding.resize(tensors["field.encoding.tables"].shape[1])
        field.load_state_dict({name.removeprefix("field."): t.float() for name, t in tensors.items() if name.startswith("field.")})
        poses, depths = tensors["views.T_wc"].numpy(), tensors["views.depth"].numpy().astype(np.float32) / 1000
    except (OSError, SafetensorError, KeyError, TypeError, ValueError, RuntimeError) as error:
        raise ResultError(f"{path}: cannot be read as a map ({type(error).__name__}: {error}); expected a run's map.safetensors") from error
    field.requires_grad_(False)
    return SavedMap(field, [View(pose, depth, camera) for pose, depth in zip(poses, depths)])
