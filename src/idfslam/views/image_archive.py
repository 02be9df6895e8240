"""The archive of images of a run, and its file: what a view of the map shows."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from idfslam.compute.ahead import ahead
from idfslam.errors import ConfigError, ResultError
from idfslam.geometry.camera import Camera
from idfslam.geometry.depth_view import DepthView, reduced_view
from idfslam.storage.safetensors_file import ordered
from idfslam.views.encoded_view import DEPTH_ROWS, EncodedView, decode_colour, decode_depth
from idfslam.views.exposures import solve_exposures
from idfslam.views.lit_area import LitArea

FORMAT = 1  # format of the file, counted up with each change that older versions cannot read


@dataclass(frozen=True, eq=False)
class ImageArchive:
    """V images of one camera with their poses and exposures."""

    views: Sequence[EncodedView]
    camera: Camera  # of colour
    T_wc: NDArray[np.float64]  # (V, 4, 4)
    exposures: NDArray[np.float64]  # (V, 3, 2) logarithm of the gain, and the offset, of each channel: colour = gain (scene + offset)
    lit: NDArray[np.bool_]  # (H, W) whether the images fill a pixel (`lit_area`)

    def colour(self, i: int) -> NDArray[np.uint8]:
        """RGB (H, W, 3) of the i-th image. Raises ResultError if its data are damaged."""
        image = decode_colour(self.views[i].colour)
        if image is None or image.shape != (self.camera.height, self.camera.width, 3):
            raise ResultError(f"the archive's image of frame {self.views[i].index} is damaged; run again")
        return image

    def moving(self, i: int) -> NDArray[np.bool_]:
        """(H, W) which pixels of the i-th image show what moves, at the resolution of its depth image."""
        hidden, size = (self.depths[i].depth < 0).astype(np.uint8), (self.camera.width, self.camera.height)
        return np.asarray(cv2.resize(hidden, size, interpolation=cv2.INTER_NEAREST) > 0)

    @cached_property
    def depths(self) -> list[DepthView]:
        """The depth images. Raises ResultError if the data of one are damaged."""
        small = reduced_view(np.eye(4), np.zeros((self.camera.height, self.camera.width), np.float32), self.camera, DEPTH_ROWS).camera
        found = []
        for view, T_wc in zip(self.views, self.T_wc):
            depth = decode_depth(view.depth)
            if depth is None or depth.shape != (small.height, small.width):
                raise ResultError(f"the archive's depth of frame {view.index} is damaged; run again")
            found.append(DepthView(T_wc, depth, small))
        return found

    @property
    def size(self) -> int:
        """[bytes] of all images."""
        return sum(view.size for view in self.views)


def archive_of(views: Sequence[EncodedView], camera: Camera, T_wc: NDArray[np.float64]) -> ImageArchive:
    """The archive of images with poses (V, 4, 4), whose exposures and filled pixels are worked out."""
    lit = LitArea(camera.height, camera.width)
    plain = ImageArchive(views, camera, T_wc, np.zeros((len(views), 3, 2)), lit.pixels())
    found = solve_exposures(lit.watched(ahead(plain.colour, range(len(views)))), plain.depths)
    return replace(plain, exposures=found, lit=lit.pixels())


def save_archive(path: Path, archive: ImageArchive) -> None:
    """Writes an archive as one safetensors file. Equal archives give equal files.

    `colour` and `depth` hold the files of all images one after the other, `colour_ends` and `depth_ends` (V,) where each ends.
    """
    tensors: dict[str, Tensor] = {
        "index": torch.tensor([view.index for view in archive.views], dtype=torch.int64),
        "sharpness": torch.tensor([view.sharpness for view in archive.views], dtype=torch.float64),
        "T_wc": torch.from_numpy(archive.T_wc),
        "exposures": torch.from_numpy(archive.exposures),
        "lit": torch.from_numpy(np.packbits(archive.lit)),
    }
    for kind, files in (("colour", [v.colour for v in archive.views]), ("depth", [v.depth for v in archive.views])):
        tensors[kind] = torch.from_numpy(np.frombuffer(b"".join(files), np.uint8).copy())
        tensors[f"{kind}_ends"] = torch.tensor(np.cumsum([len(data) for data in files]), dtype=torch.int64)
    metadata = {"format": str(FORMAT), "camera": json.dumps(asdict(archive.camera))}
    path.write_bytes(ordered(save(tensors, metadata)))


def load_archive(path: Path) -> ImageArchive:
    """Reads an archive. Raises ResultError if the file is damaged, no archive, or of another format."""
    try:
        with safe_open(path, "pt") as file:
            metadata = file.metadata() or {}
            if (found := metadata.get("format", "none")) != str(FORMAT):
                raise ResultError(f"{path}: archive format {found}, expected {FORMAT}; use the version of idf-slam that wrote it")
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (safe_open is no mapping)
        return _archive(Camera(**json.loads(metadata["camera"])), tensors)
    except (OSError, SafetensorError, ConfigError, KeyError, TypeError, ValueError, AttributeError) as error:
        what = f"{type(error).__name__}: {error}"
        raise ResultError(f"{path}: cannot be read as an archive of images ({what}); expected a run's archive.safetensors") from error


def _archive(camera: Camera, tensors: dict[str, Tensor]) -> ImageArchive:
    """The archive of a file's tensors. Raises ValueError if they do not fit together."""
    index, T_wc, exposures = tensors["index"].tolist(), tensors["T_wc"].numpy(), tensors["exposures"].numpy()
    sharpness = tensors["sharpness"].tolist()
    if T_wc.shape != (len(index), 4, 4) or exposures.shape != (len(index), 3, 2) or len(sharpness) != len(index):
        raise ValueError(f"{len(index)} images, poses {T_wc.shape}, exposures {exposures.shape}")
    if not (np.isfinite(T_wc).all() and np.isfinite(exposures).all()):
        raise ValueError("a pose or an exposure is not finite")
    pixels, bits = camera.height * camera.width, tensors["lit"].numpy()
    if bits.dtype != np.uint8 or bits.shape != (-(-pixels // 8),):
        raise ValueError(f"lit: {bits.shape} bytes for {camera.width} x {camera.height} pixels")
    lit = np.unpackbits(bits)[:pixels].reshape(camera.height, camera.width).astype(bool)
    colours, depths = (_files(tensors, kind, len(index)) for kind in ("colour", "depth"))
    views = [EncodedView(*columns) for columns in zip(index, colours, depths, sharpness)]
    return ImageArchive(views, camera, T_wc.astype(np.float64), exposures.astype(np.float64), lit)


def _files(tensors: dict[str, Tensor], kind: str, count: int) -> list[bytes]:
    """The files of all images of a kind. Raises ValueError if they do not fill the tensor in order."""
    data, ends = tensors[kind].numpy(), tensors[f"{kind}_ends"].numpy()
    begins = np.concatenate([[0], ends[:-1]])
    if data.dtype != np.uint8 or len(ends) != count or (count and ends[-1] != len(data)) or (ends < begins).any() or (begins < 0).any():
        raise ValueError(f"{kind}: {len(data)} bytes do not fall into {count} images")
    return [data[a:b].tobytes() for a, b in zip(begins, ends)]
