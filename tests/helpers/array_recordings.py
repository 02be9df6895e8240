"""Files with the arrays of all frames: HDF5, MATLAB 5 and 7.3, .npz."""

from pathlib import Path

import numpy as np
import pytest

from helpers.recordings import colour_image, depth_image, pose

K = np.array([[15, 0, 7.5], [0, 15, 5.5], [0, 0, 1]])
DEPTH = np.stack([depth_image(1000) / np.float32(1000) * (1 + i) for i in range(4)]).astype(np.float32)  # (N, H, W) [m]
RGB = np.stack([colour_image(i)[..., ::-1] for i in range(4)])  # (N, H, W, 3)
POSES = np.stack([pose(i) for i in range(4)])
STAMPS = 5 + np.arange(4) / 10


def write_hdf5(path: Path, **arrays: np.ndarray) -> Path:
    with pytest.importorskip("h5py").File(path.with_suffix(".h5"), "w") as file:
        for name, array in arrays.items():
            file[f"scene/{name}"] = array
    return path.with_suffix(".h5")


def write_npz(path: Path, **arrays: np.ndarray) -> Path:
    np.savez(path.with_suffix(".npz"), **arrays)
    return path.with_suffix(".npz")


def write_mat(path: Path, **arrays: np.ndarray) -> Path:
    """MATLAB counts images by the last axis."""
    from scipy.io import savemat

    savemat(path.with_suffix(".mat"), {name: np.moveaxis(array, 0, -1) if array.ndim > 2 else array for name, array in arrays.items()})
    return path.with_suffix(".mat")


def write_mat_73(path: Path, **arrays: np.ndarray) -> Path:
    """HDF5 with the axes of the arrays above reversed, and references as cells have them."""
    h5py = pytest.importorskip("h5py")
    with h5py.File(path.with_suffix(".mat"), "w", userblock_size=512) as file:
        for name, array in arrays.items():
            file[name] = (np.moveaxis(array, 0, -1) if array.ndim > 2 else array).T
            file[name].attrs["MATLAB_class"] = np.bytes_("double")
        file["names"] = np.array([file[name].ref for name in arrays], h5py.ref_dtype)
    data = path.with_suffix(".mat").read_bytes()
    path.with_suffix(".mat").write_bytes(b"MATLAB 7.3 MAT-file".ljust(512) + data[512:])
    return path.with_suffix(".mat")
