"""Depth images stored as arrays: NumPy, OpenEXR, HDF5, MATLAB. One function a kind; none of them runs code from a file."""

import math
import zipfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from idfslam.datasets.images.matlab_file import is_hdf5, read_matlab
from idfslam.errors import ConfigError, FrameError, IdfSlamError, pip_install

MOST_VALUES = 2**26  # [1] values of one image that is read; raised, a damaged header can claim more memory. 64 million, chosen by hand
MOST_OF_ALL = 2**32  # [1] values of one array with all frames; raised, likewise. 4 thousand million, chosen by hand
_DEPTH_NAMES = ("depth", "depths", "z", "depthmap", "depthimage", "rawdepth", "rawdepths", "data", "arr0", "image")  # most wanted first


def read_array(path: Path) -> NDArray[Any]:
    """The depth array of a file, of any shape and type; raises FrameError, and ConfigError if a package for it is missing."""
    with readable(path, FrameError):
        return READERS[path.suffix.lower()](path)


@contextmanager
def readable(path: Path, error_type: type[IdfSlamError]) -> Iterator[None]:
    """Turns whatever a parser raises for a damaged file into an error of one line."""
    try:
        yield
    except IdfSlamError:
        raise
    except OSError as error:
        raise error_type(f"{path}: {error.strerror or _line(error)}, expected a file of arrays: copy the recording again") from error
    except Exception as error:  # what the parsers of other packages raise for damaged files is not documented
        raise error_type(f"{path}: not readable ({_line(error)}): copy the recording again or leave it out") from error


def _npy(path: Path) -> NDArray[Any]:
    with path.open("rb") as file:
        return _npy_array(file, path)


def _npz(path: Path) -> NDArray[Any]:
    with zipfile.ZipFile(path) as archive:
        names = _npz_names(archive)
        with archive.open(names[wanted(list(names), _DEPTH_NAMES, str(path))]) as file:
            return _npy_array(file, path)


def npz_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """All arrays of a .npz file with numbers for many images, by name."""
    with zipfile.ZipFile(path) as archive:
        return {name: _npy_array(archive.open(member), path, MOST_OF_ALL) for name, member in _npz_names(archive).items()}


def _npz_names(archive: zipfile.ZipFile) -> dict[str, str]:
    return {name.removesuffix(".npy"): name for name in archive.namelist() if name.endswith(".npy")}


def _npy_array(file: IO[bytes], path: Path, most: int = MOST_VALUES) -> NDArray[Any]:
    """The array of a .npy stream. Not np.load: the size is checked before memory is asked for, and objects (pickles) are refused."""
    version = np.lib.format.read_magic(file)
    read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, fortran, dtype = read_header(file)
    count = math.prod(shape)
    if dtype.hasobject or not 0 < count <= most:
        raise FrameError(f"{path}: an array of {shape} {dtype}, expected the numbers of one depth image")
    data = file.read(count * dtype.itemsize)
    if len(data) < count * dtype.itemsize:
        raise FrameError(f"{path}: cut off ({len(data)} of {count * dtype.itemsize} bytes): copy the recording again")
    return np.frombuffer(data, dtype).reshape(shape, order="F" if fortran else "C")


def _exr(path: Path) -> NDArray[Any]:
    try:
        import OpenEXR
    except ImportError as error:
        raise ConfigError(f"reading OpenEXR images needs OpenEXR: {pip_install('OpenEXR')}") from error
    with OpenEXR.File(str(path), separate_channels=True) as file:
        channels = file.channels()
        name = wanted(list(channels), ("z", "y", "depthz", "depthv", "depth", "r", "v"), str(path))
        return np.array(channels[name].pixels)


def _hdf5(path: Path) -> NDArray[Any]:
    with open_hdf5(path) as file:
        data = {name: array for name, array in hdf5_arrays(file).items() if array.ndim >= 2}
        return _one_image(data[wanted(list(data), _DEPTH_NAMES, str(path))], path)


def open_hdf5(path: Path) -> Any:
    """The opened h5py.File; raises ConfigError if h5py is not installed."""
    try:
        import h5py
    except ImportError as error:
        raise ConfigError(f"reading {path.name} needs h5py: {pip_install('h5py')}") from error
    return h5py.File(path, "r")


def hdf5_arrays(file: Any) -> dict[str, Any]:
    """The datasets of numbers in an h5py.File, by their paths."""
    arrays: dict[str, Any] = {}

    def visit(name: str, item: Any) -> None:
        if getattr(item, "ndim", 0) >= 1 and item.dtype.kind in "fiub" and not name.startswith("#refs#"):
            arrays[name] = item

    file.visititems(visit)
    return arrays


def _one_image(data: Any, path: Path) -> NDArray[Any]:
    if data.size > MOST_VALUES:
        raise FrameError(f"{path}: an array of {data.shape}, expected the numbers of one depth image")
    return in_matlab_order(np.asarray(data[()]), data)


def in_matlab_order(values: NDArray[Any], stored: Any) -> NDArray[Any]:
    """Values of an array that is stored in a file: MATLAB reverses the axes in HDF5 files."""
    return values.T if "MATLAB_class" in getattr(stored, "attrs", ()) else values


def _mat(path: Path) -> NDArray[Any]:
    if is_hdf5(path):
        return _hdf5(path)
    arrays = read_matlab(path)
    return arrays[wanted(list(arrays), _DEPTH_NAMES, str(path))]


def wanted(names: list[str], preferred: tuple[str, ...], source: str) -> str:
    """The name among `names` (the last part of a path counts) that is preferred most, else the only one; raises FrameError."""
    plain = {plain_name(name): name for name in names}
    for name in preferred:
        if name in plain:
            return plain[name]
    if len(names) == 1:
        return names[0]
    raise FrameError(f"{source}: holds {', '.join(names[:6]) or 'no arrays of numbers'}, expected one array named {preferred[0]}")


def plain_name(name: str) -> str:
    """The last part of an array's path, in letters and digits of lower case."""
    return "".join(c for c in name.rsplit("/", 1)[-1].lower() if c.isalnum())


def _line(error: Exception) -> str:
    words = str(error).splitlines()
    return words[0].strip().rstrip(".")[:120] if words else type(error).__name__


READERS: Mapping[str, Callable[[Path], NDArray[Any]]] = {
    ".npy": _npy,
    ".npz": _npz,
    ".exr": _exr,
    ".h5": _hdf5,
    ".hdf5": _hdf5,
    ".mat": _mat,
}
