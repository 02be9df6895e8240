"""The reader of MATLAB 5 files against scipy's writer and reader."""

from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat, savemat

from idfslam.datasets.images.matlab_file import read_matlab


@pytest.mark.parametrize("compressed", [False, True])
def test_arrays_are_those_that_scipy_reads(compressed: bool, tmp_path: Path) -> None:
    random = np.random.default_rng(4)
    kinds = {"u1": (3, 4), "i2": (5, 1), "u2": (4, 3, 2), "i4": (2, 2), "f4": (3, 5), "f8": (7, 2), "u8": (1, 1)}
    values: dict[str, object] = {f"a_{kind}": random.integers(0, 100, shape).astype(kind) for kind, shape in kinds.items()}
    values |= {"text": "words", "cell": np.array([1, "a"], object), "structure": {"depth": np.eye(2)}}
    values |= {"complex": np.array([[1j, 2]]), "empty": np.zeros((0, 3))}
    savemat(tmp_path / "a.mat", values, do_compression=compressed)
    arrays, expected = read_matlab(tmp_path / "a.mat"), loadmat(tmp_path / "a.mat")
    assert sorted(arrays) == sorted(name for name in values if name.startswith("a_"))
    for name, array in arrays.items():
        assert array.dtype == expected[name].dtype
        np.testing.assert_array_equal(array, expected[name])
