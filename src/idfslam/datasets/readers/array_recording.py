"""One file with the arrays of all frames: MATLAB (as NYU Depth's labelled set), HDF5, or .npz; the camera in it, or in files beside it.

Arrays are found by their names: depth, depths or rawDepths; images, rgb or color; K or intrinsics; timestamps; poses (camera-to-world).
Floating-point depth is in metres, integers are millimetres.
"""

import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from idfslam.datasets.cameras.calibration import Calibration
from idfslam.datasets.cameras.camera_text import from_matrix
from idfslam.datasets.images.array_files import hdf5_arrays, in_matlab_order, npz_arrays, open_hdf5, plain_name, readable
from idfslam.datasets.images.decoding import Depth, as_depth
from idfslam.datasets.images.depth_units import metres_if
from idfslam.datasets.images.matlab_file import is_hdf5, read_matlab
from idfslam.datasets.poses.truth import Truth
from idfslam.datasets.provenance import ASSUMED, STATED
from idfslam.datasets.recording import Reader, Recording, regular_stamps
from idfslam.datasets.time_stamps import in_seconds
from idfslam.errors import FrameError, IdfSlamError, RecordingError

_SUFFIXES = frozenset({".mat", ".h5", ".hdf5", ".npz"})
_DEPTH = ("depth", "depths", "depthimages", "rawdepths", "rawdepth")
_COLOUR = ("images", "image", "rgb", "rgbs", "color", "colors", "colour", "colours", "rgbimages", "colorimages")
_CAMERA = ("k", "intrinsics", "intrinsic", "cameramatrix", "intrinsicmatrix")
_STAMPS = ("timestamps", "timestamp", "stamps", "times", "time")
_POSES = ("poses", "twc", "cameraposes", "campositions", "cam2world", "camtoworld")


def recognises(path: Path) -> bool:
    """A file of such a kind, or a folder with one that holds colour and depth."""
    if path.is_file():
        return path.suffix.lower() in _SUFFIXES
    files = _files(path)
    if len(files) != 1:
        return False
    try:
        arrays = ArrayFile(files[0])
    except IdfSlamError:
        return False
    return arrays.named(_DEPTH, 3) is not None and arrays.named(_COLOUR, 4) is not None


def _files(path: Path) -> list[Path]:
    return sorted(file for file in path.glob("*") if file.suffix.lower() in _SUFFIXES and not file.name.startswith("."))


def open_array_recording(path: Path, stated: Calibration) -> Recording:
    """Opens a file, or the only one in a folder."""
    files = [path] if path.is_file() else _files(path)
    if len(files) != 1:
        raise RecordingError(f"{path}: {len(files)} files of arrays (.mat, .h5, .npz), expected one: name it")
    arrays = ArrayFile(files[0])
    depth, colour = arrays.named(_DEPTH, 3), arrays.named(_COLOUR, 4)
    if depth is None or colour is None:
        missing = "depth (3 dimensions, named depth or depths)" if depth is None else "colour (4 dimensions, named images or rgb)"
        raise RecordingError(f"{files[0]}: holds {arrays.content()}, expected an array of {missing}")
    images = ArrayImages(arrays, depth, colour)
    stamps, stamps_source = arrays.stamps(len(images))
    floats = np.issubdtype(depth.dtype, np.floating)
    return Recording(
        files[0].stem,
        images,
        timestamps=stamps,
        stamps_source=stamps_source,
        ground_truth=lambda: arrays.truth(images.frames_last),
        calibration=stated.over(arrays.camera()).over(metres_if(floats)),
    )


class ArrayFile:
    """The arrays of numbers in a file. Raises RecordingError if it cannot be read, ConfigError if a package for it is missing."""

    def __init__(self, path: Path) -> None:
        self.path, self.is_matlab_5 = path, False
        with readable(path, RecordingError):
            self._arrays = self._opened()

    def _opened(self) -> Mapping[str, Any]:
        if self.path.suffix.lower() == ".npz":
            return npz_arrays(self.path)
        self.is_matlab_5 = self.path.suffix.lower() == ".mat" and not is_hdf5(self.path)
        return read_matlab(self.path) if self.is_matlab_5 else hdf5_arrays(open_hdf5(self.path))

    def named(self, names: Sequence[str], dimensions: int) -> Any | None:
        """The array with the first of these names and so many dimensions; None if there is none."""
        arrays = {plain_name(name): array for name, array in self._arrays.items() if array.ndim == dimensions}
        return next((arrays[name] for name in names if name in arrays), None)

    def content(self) -> str:
        """The names and shapes of the first arrays, in words."""
        return ", ".join(f"{name} {tuple(array.shape)}" for name, array in list(self._arrays.items())[:6]) or "no arrays of numbers"

    def camera(self) -> Calibration:
        """The camera of a matrix K (3, 3); empty without one."""
        K = self.named(_CAMERA, 2)
        if K is None or K.shape != (3, 3):
            return Calibration()
        with readable(self.path, RecordingError):
            matrix = np.array(K[()], np.float64)
        return from_matrix(matrix.T if matrix[2, 0] > 1 else matrix, str(self.path))

    def stamps(self, count: int) -> tuple[NDArray[np.float64], str]:
        """(N,) stamps [s], and where they come from."""
        arrays = [
            array for array in (self.named(_STAMPS, dimensions) for dimensions in (1, 2)) if array is not None and array.size == count
        ]
        with readable(self.path, RecordingError):
            stamps = np.array(arrays[0][()], np.float64).ravel() if arrays else np.full(count, np.nan)
        if np.isfinite(stamps).all() and np.all(np.diff(stamps) > 0):
            return in_seconds(stamps, str(self.path)), STATED
        return regular_stamps(count), ASSUMED

    def truth(self, frames_last: bool) -> Truth | None:
        """The poses (N, 4, 4), camera-to-world; None without them."""
        poses = self.named(_POSES, 3)
        if poses is None:
            return None
        with readable(self.path, RecordingError):
            count = poses.shape[-1 if frames_last else 0]
            return Truth(np.stack([slice_of(poses, i, frames_last) for i in range(count)]).astype(np.float64), str(self.path))


def slice_of(array: Any, i: int, frames_last: bool) -> NDArray[Any]:
    """What an array holds of frame i, the first axis or, with `frames_last`, the last one being that of frames: one dimension less."""
    return in_matlab_order(np.asarray(array[..., i] if frames_last else array[i]), array)


class ArrayImages:
    """Called with i, returns colour (H, W, 3) BGR and depth (H, W) of frame i. Threads are served one at a time."""

    def __init__(self, file: ArrayFile, depth: Any, colour: Any) -> None:
        self._path, self._depth, self._colour, self._lock = file.path, depth, colour, threading.Lock()
        # In (N, H, W, 3) and (N, 3, H, W) frames are counted first, in MATLAB's (H, W, 3, N) last: what is left without channels is depth
        axes = (2, 0) if file.is_matlab_5 else (3, 1, 2, 0)
        shapes = {axis: colour.shape[:axis] + colour.shape[axis + 1 :] for axis in axes if colour.shape[axis] == 3}
        channels = next((axis for axis, shape in shapes.items() if shape == depth.shape), None)
        if channels is None:
            found = f"depth {tuple(depth.shape)} and colour {tuple(colour.shape)}"
            raise RecordingError(f"{file.path}: {found}, expected equally many images of one size, colour with 3 channels")
        self.frames_last = channels in (2, 0)
        self._count = depth.shape[-1 if self.frames_last else 0]

    def __len__(self) -> int:
        return int(self._count)

    def __call__(self, i: int) -> tuple[NDArray[np.uint8], Depth]:
        source = f"{self._path}: frame {i}"
        with self._lock, readable(self._path, FrameError):
            depth, colour = (slice_of(array, i, self.frames_last) for array in (self._depth, self._colour))
        rgb = colour if colour.shape[2] == 3 else np.moveaxis(colour, 0, -1)
        if rgb.dtype.kind == "f":  # of 0 to 1
            rgb = np.rint(255 * np.nan_to_num(rgb).clip(0, 1))
        return np.ascontiguousarray(rgb[..., ::-1], np.uint8), as_depth(depth, source)


READER = Reader("arrays", "a .mat, .h5 or .npz file with depth and images of all frames", recognises, open_array_recording)
