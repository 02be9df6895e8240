"""Record3D (iPhone and iPad): a .r3d file, which is a zip of metadata, rgbd/N.jpg, rgbd/N.depth and rgbd/N.conf, or such a zip unpacked.

Depth is float32 metres, packed with LZFSE, of 192x256 pixels; colour has 720x960 (upright). Both become 480x640 (see `resampling`).
Readings of low confidence are left out. ARKit's poses, with y up and z backwards, are converted to OpenCV's axes and are the ground truth.
"""

import lzma
import struct
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from idfslam.datasets.cameras.calibration import Calibration
from idfslam.datasets.images.confidence import MEDIUM
from idfslam.datasets.images.decoding import Depth, decode_colour
from idfslam.datasets.images.lzfse_blocks import unpacked_size
from idfslam.datasets.images.resampling import downscaled_colour, limited_size, upscaled_depth
from idfslam.datasets.near_miss import Likeness, part
from idfslam.datasets.poses.pose_file import from_quaternions
from idfslam.datasets.poses.truth import Truth
from idfslam.datasets.provenance import ASSUMED, STATED
from idfslam.datasets.recording import Reader, Recording, regular_stamps
from idfslam.errors import ConfigError, FrameError, RecordingError, pip_install
from idfslam.geometry.transforms_json import OPENGL
from idfslam.storage.json_file import parse_json
from idfslam.storage.plain_values import LARGEST, fault, shown

# What zipfile raises for damaged, encrypted and unusual archives
_ZIP_ERRORS = (zipfile.BadZipFile, zlib.error, lzma.LZMAError, struct.error, EOFError, NotImplementedError, RuntimeError, ValueError)
_DEPTH_SIZES = ((192, 256), (480, 640))  # width, height [px] of LiDAR and TrueDepth, upright, if the metadata has none: a fact of the
#    cameras


def recognises(path: Path) -> bool:
    return path.suffix == ".r3d" or ((path / "rgbd").is_dir() and (path / "metadata").is_file()) or any(path.glob("*.r3d"))


def open_record3d(path: Path, stated: Calibration) -> Recording:
    """Opens a .r3d file, a folder with one, or an unpacked one."""
    if path.is_dir() and not (path / "rgbd").is_dir():
        files = sorted(path.glob("*.r3d"))
        if len(files) != 1:
            raise RecordingError(f"{path}: {len(files)} .r3d files, expected one, or the folder rgbd/ and metadata: name one")
        path = files[0]
    export = ExportFiles(path)
    metadata = read_metadata(export)
    images = Record3DImages(export, metadata.depth_size, lzfse())
    try:
        height, width, _ = images.colour(0).shape
    except FrameError as error:
        raise RecordingError(str(error)) from error
    size = limited_size(width, height)
    calibration = stated.over(metadata.camera.resized(metadata.size or (width, height), (width, height)))
    return Recording(
        path.stem,
        lambda i: (downscaled_colour(images.colour(i), size), upscaled_depth(images.depth(i), size)),
        timestamps=metadata.stamps,
        stamps_source=metadata.stamps_source,
        ground_truth=metadata.truth,
        calibration=calibration.resized((width, height), size).over(Calibration(depth_scale=1)),
    )


def lzfse() -> ModuleType:
    """The module lzfse; raises ConfigError if it is not installed."""
    try:
        import lzfse
    except ImportError as error:
        raise ConfigError(f"reading Record3D needs lzfse: {pip_install('lzfse')}") from error
    return lzfse


class ExportFiles:
    """The files of a zip, or the files of a folder, by name; threads may share it. Raises RecordingError if a zip cannot be opened."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._zip = None if path.is_dir() else zipfile.ZipFile(path)
        except _ZIP_ERRORS as error:
            raise RecordingError(f"{path}: {shown(error)}, expected a zip as Record3D exports it: copy the recording again") from error
        self._names = frozenset(self._zip.namelist() if self._zip else ())

    def __contains__(self, name: str) -> bool:
        return name in self._names if self._zip else (self.path / name).is_file()

    def read(self, name: str) -> bytes:
        """The content of a file; raises FrameError if it is missing or damaged."""
        try:
            size = self._zip.getinfo(name).file_size if self._zip else (self.path / name).stat().st_size
            if size > LARGEST:
                raise FrameError(f"{self.path}: {name} has {size >> 20} MB, expected less than {LARGEST >> 20} MB: export again")
            return self._zip.read(name) if self._zip else (self.path / name).read_bytes()
        except (KeyError, OSError) as error:
            raise FrameError(f"{self.path}: {name} is missing, expected an export of Record3D: export the recording again") from error
        except _ZIP_ERRORS as error:
            raise FrameError(f"{self.path}: {name} is damaged ({shown(error)}): copy the recording again") from error


@dataclass(frozen=True)
class Record3DImages:
    """Reads colour and depth of frame i, each at its own size."""

    files: ExportFiles
    size: tuple[int, int] | None  # width, height [px] of depth
    lzfse: ModuleType

    def colour(self, i: int) -> NDArray[np.uint8]:
        """(H, W, 3) BGR."""
        name = f"rgbd/{i}.jpg"
        return decode_colour(self.files.read(name), f"{self.files.path}: {name}")

    def depth(self, i: int) -> Depth:
        """(h, w) [m], 0 where there is no reading or its confidence is low."""
        name = f"rgbd/{i}.depth"
        data = self._unpacked(name)
        width, height = self.size or next((size for size in _DEPTH_SIZES if len(data) == 4 * size[0] * size[1]), _DEPTH_SIZES[0])
        raw = self._shaped(data, name, np.dtype("<f4"), width, height)
        if (name := f"rgbd/{i}.conf") not in self.files:  # TrueDepth has none
            return raw
        confidence = self._shaped(self._unpacked(name), name, np.dtype(np.uint8), width, height)
        return np.where(confidence >= MEDIUM, raw, 0).astype(np.float32)

    def _unpacked(self, name: str) -> bytes:
        data = self.files.read(name)
        try:
            if (size := unpacked_size(data)) > LARGEST:
                raise ValueError(f"{size} bytes")
            return bytes(self.lzfse.decompress(data))
        except (ValueError, MemoryError, self.lzfse.error) as error:  # MemoryError: for damaged data lzfse asks for ever more
            raise FrameError(f"{self.files.path}: {name} cannot be unpacked, expected LZFSE: copy the recording again") from error

    def _shaped(self, data: bytes, name: str, dtype: np.dtype[Any], width: int, height: int) -> NDArray[Any]:
        if len(data) != width * height * dtype.itemsize:
            found = f"{name} holds {len(data)} bytes, expected {width}x{height} of {dtype.itemsize}"
            raise FrameError(f"{self.files.path}: {found}: export the recording again")
        return np.frombuffer(data, dtype).reshape(height, width)


@dataclass(frozen=True, eq=False)
class Metadata:
    """The content of the file `metadata` for N frames."""

    camera: Calibration  # the median over the frames: autofocus changes the camera from frame to frame
    size: tuple[int, int] | None  # width, height [px] of the images that the camera is valid for
    depth_size: tuple[int, int] | None
    stamps: NDArray[np.float64]  # (N,) [s]
    stamps_source: str
    poses: Any  # N rows of qx qy qz qw, x y z, as they are stored; None: none are
    source: str

    def truth(self) -> Truth | None:
        """The poses. Raises ValueError if they are no table."""
        if not self.poses:
            return None
        table = np.array(self.poses, np.float64).reshape(-1, 7)
        return Truth(from_quaternions(table[:, 4:], table[:, :4]) @ OPENGL, self.source)


def read_metadata(files: ExportFiles) -> Metadata:
    """Reads `metadata`; raises RecordingError if it is missing or malformed."""
    source = f"{files.path}: metadata"
    try:
        values = parse_json(files.read("metadata"), source=source, error=RecordingError, expected="Record3D's K, w, h, poses")
        K = np.array(values["K"], np.float64).reshape(3, 3).T  # stored column by column
        cameras = np.array(values.get("perFrameIntrinsicCoeffs") or [[K[0, 0], K[1, 1], K[0, 2], K[1, 2]]], np.float64).reshape(-1, 4)
        stamps = np.array(values.get("frameTimestamps") or [], np.float64).reshape(-1)
        size, depth_size = ((int(values[w]), int(values[h])) if w in values else None for w, h in (("w", "h"), ("dw", "dh")))
        fps = float(values.get("fps") or 0)
        if any(side <= 0 for side in (*(size or ()), *(depth_size or ()))):
            raise ValueError(f"sizes {size} and {depth_size}")
    except FrameError as error:
        raise RecordingError(str(error)) from error
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
        raise RecordingError(f"{source}: {fault(error)}, expected Record3D's K, w, h, poses: export it again") from error
    count = 0
    while f"rgbd/{count}.jpg" in files:
        count += 1
    if not count:
        raise RecordingError(f"{files.path}: no rgbd/0.jpg, expected an export of Record3D: rgbd/N.jpg, rgbd/N.depth, metadata")
    stamps_source = STATED
    if len(stamps) != count or np.any(np.diff(stamps) <= 0):
        stamps, stamps_source = (np.arange(count) / fps, "stated rate") if fps > 0 else (regular_stamps(count), ASSUMED)
    fx, fy, cx, cy = (float(value) for value in np.median(cameras, 0))
    return Metadata(
        Calibration(fx, fy, cx, cy, source=source),
        size,
        depth_size,
        stamps,
        stamps_source,
        values.get("poses"),
        source,
    )


READER = Reader(
    "record3d",
    "a .r3d file, or rgbd/ and metadata of Record3D",
    recognises,
    open_record3d,
    likeness=Likeness("an unpacked recording of Record3D", (part("rgbd", "rgbd/"), part("metadata"))),
)
