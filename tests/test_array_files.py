"""Depth images of every kind of file: what is a reading, in which units, and that nothing in a file is run."""

import os
import pickle
import re
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from helpers.recordings import (
    DEPTH,
    HEIGHT,
    WIDTH,
    depth_image,
    write_folder,
    write_icl_nuim,
    write_replica,
    write_scannet,
    write_tum,
)
from idfslam.datasets import open_recording
from idfslam.datasets.images.decoding import as_depth, holds_floats, read_depth, readings
from idfslam.errors import ConfigError, FrameError, RecordingError


def write_npz(path: Path, depth: np.ndarray) -> None:
    np.savez_compressed(path, confidence=np.zeros((2, 2)), depth=depth)


def write_exr(path: Path, depth: np.ndarray) -> None:
    exr = pytest.importorskip("OpenEXR")
    exr.File({"compression": exr.ZIP_COMPRESSION, "type": exr.scanlineimage}, {"Z": depth.astype(np.float32)}).write(str(path))


def write_hdf5(path: Path, depth: np.ndarray) -> None:
    with pytest.importorskip("h5py").File(path, "w") as file:
        file["frame/depth"] = depth
        file["frame/confidence"] = np.zeros((HEIGHT, WIDTH), np.uint8)


def write_mat(path: Path, depth: np.ndarray) -> None:
    from scipy.io import savemat

    savemat(path, {"depth": depth, "note": "metres", "K": np.eye(3)})


def write_mat_73(path: Path, depth: np.ndarray) -> None:
    """As MATLAB does: an HDF5 file after 512 bytes of its own, with the axes reversed."""
    with pytest.importorskip("h5py").File(path, "w", userblock_size=512) as file:
        file["depth"] = depth.T
        file["depth"].attrs["MATLAB_class"] = np.bytes_("single")
    data = path.read_bytes()
    path.write_bytes(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512) + data[512:])


def write_opencv(path: Path, depth: np.ndarray) -> None:
    assert cv2.imwrite(str(path), depth)


def write_raw(path: Path, depth: np.ndarray) -> None:
    path.write_bytes(depth.tobytes())


FLOATS: dict[str, tuple[str, Callable[[Path, np.ndarray], None]]] = {
    "TIFF": (".tiff", write_opencv),
    "PFM": (".pfm", write_opencv),
    "npy": (".npy", lambda path, depth: np.save(path, depth)),
    "npy, column by column": (".npy", lambda path, depth: np.save(path, np.asfortranarray(depth.astype(np.float64)))),
    "npy, one channel": (".npy", lambda path, depth: np.save(path, depth[..., None])),
    "npz": (".npz", write_npz),
    "EXR": (".exr", write_exr),
    "HDF5": (".h5", write_hdf5),
    "MATLAB 5": (".mat", write_mat),
    "MATLAB 7.3": (".mat", write_mat_73),
}
INTEGERS: dict[str, tuple[str, Callable[[Path, np.ndarray], None]]] = {
    "TIFF": (".TIF", write_opencv),
    "PGM": (".pgm", write_opencv),
    "npy": (".npy", lambda path, depth: np.save(path, depth)),
    "npy, 32 bits": (".npy", lambda path, depth: np.save(path, depth.astype(np.int32))),
    "HDF5": (".hdf5", write_hdf5),
    "MATLAB 5": (".mat", write_mat),
    "raw": (".raw", write_raw),
}


def with_depth(path: Path, suffix: str, write: Callable[[Path, np.ndarray], None], depth: np.ndarray) -> Path:
    """A plain folder whose depth images are all `depth`, in files of another kind."""
    write_folder(path)
    for file in list((path / "depth").iterdir()):
        file.unlink()
        write(file.with_suffix(suffix), depth)
    return path


def float_image() -> np.ndarray:
    """(H, W) float32 [m]: 1 m; each value without a reading once, in the first row."""
    image = np.full((HEIGHT, WIDTH), DEPTH, np.float32)
    image[0, :6] = 0, np.nan, np.inf, -np.inf, -1, 65535
    return image


@pytest.mark.parametrize("kind", FLOATS)
def test_floats_are_metres_unless_a_scale_is_stated(kind: str, tmp_path: Path) -> None:
    path = with_depth(tmp_path / "room", *FLOATS[kind], float_image())
    recording = open_recording(path)
    depth = recording[2].depth
    assert depth.dtype == np.float32 and depth.shape == (HEIGHT, WIDTH)
    np.testing.assert_array_equal(depth[0, :6], 0)
    np.testing.assert_allclose(depth[0, 6:], 1)
    np.testing.assert_allclose(depth[1:], 1)
    assert recording.provenance is not None and recording.provenance.depth == "float images are metres"
    np.testing.assert_allclose(open_recording(path, depth_scale=2)[0].depth[1:], 0.5)


@pytest.mark.parametrize("name", ["tum", "replica", "icl_nuim", "scannet"])
def test_floats_are_metres_in_layouts_whose_integers_are_something_else(name: str, tmp_path: Path) -> None:
    writers = {"tum": write_tum, "replica": write_replica, "icl_nuim": write_icl_nuim, "scannet": write_scannet}
    path = writers[name](tmp_path / "room", cam_params=False)
    (path / "intrinsics.txt").write_text("15 15 7.5 5.5\n")
    for file in [file for file in path.rglob("*.png") if "depth" in str(file.relative_to(path))]:
        write_opencv(file.with_suffix(".tiff"), float_image())
        file.unlink()
    for file in path.glob("*.txt"):
        lines = [re.sub(r"(depth/\S+)\.png", r"\1.tiff", line) for line in file.read_text().splitlines()]
        file.write_text("\n".join(lines) + "\n")
    recording = open_recording(path, format=name)
    np.testing.assert_allclose(recording[1].depth[1:], 1)
    assert recording.provenance is not None and recording.provenance.depth == "float images are metres"


@pytest.mark.parametrize("kind", INTEGERS)
def test_integers_are_millimetres(kind: str, tmp_path: Path) -> None:
    image = depth_image(1000)
    image[0, 1] = 65535
    depth = open_recording(with_depth(tmp_path / "room", *INTEGERS[kind], image))[1].depth
    np.testing.assert_array_equal(depth[0, :2], 0)
    np.testing.assert_allclose(depth[1:], 1, rtol=1e-6)


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64])
def test_floats_of_any_width(dtype: type, tmp_path: Path) -> None:
    with np.errstate(over="ignore"):
        np.save(tmp_path / "0.npy", float_image().astype(dtype))
    cv2.imwrite(str(colour := tmp_path / "0.png"), np.zeros((HEIGHT, WIDTH, 3), np.uint8))
    raw = read_depth(tmp_path / "0.npy")
    assert raw.dtype == np.float32 and holds_floats(colour, tmp_path / "0.npy")
    expected = 5 if dtype == np.float16 else 6  # 65535 is beyond half precision's range: infinite
    assert (~readings(raw)).sum() >= expected and readings(raw)[1:].all()


def test_raw_floats_have_the_proportions_of_colour(tmp_path: Path) -> None:
    path = with_depth(tmp_path / "room", ".bin", write_raw, float_image())
    np.testing.assert_allclose(open_recording(path)[0].depth[1:], 1)
    for file in (path / "depth").iterdir():
        file.write_bytes(b"")
    with pytest.raises(RecordingError, match="0 bytes, expected uint16 or float32 depth"):
        open_recording(path)
    for file in (path / "depth").iterdir():
        file.write_bytes(b"\0" * 100)
    with pytest.raises(RecordingError, match="100 bytes, expected uint16 or float32 depth with the proportions of the 16x12 colour image"):
        open_recording(path)


@pytest.mark.parametrize(("suffix", "write"), [(".pgm", write_opencv), (".npy", lambda path, depth: np.save(path, depth))])
def test_eight_bits_are_refused(suffix: str, write: Callable[[Path, np.ndarray], None], tmp_path: Path) -> None:
    path = with_depth(tmp_path / "room", suffix, write, np.full((HEIGHT, WIDTH), 100, np.uint8))
    with pytest.raises(RecordingError, match=r"depth of 8-bit, 1 channel\(s\), expected one channel of 16 bits"):
        open_recording(path)


class Exploit:
    def __reduce__(self) -> tuple:
        return os.system, ("touch exploited",)


def test_pickles_are_not_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    np.save(tmp_path / "0.npy", np.array([[Exploit()]], object), allow_pickle=True)
    (tmp_path / "1.npy").write_bytes(pickle.dumps(Exploit()))
    for name in ("0.npy", "1.npy"):
        with pytest.raises(FrameError):
            read_depth(tmp_path / name)
    assert not (tmp_path / "exploited").exists()


def test_damaged_files_are_one_line(tmp_path: Path) -> None:
    """Every kind of file cut off, with a byte changed, and as rubbish: an image or FrameError of one line."""
    random = np.random.default_rng(0)
    for k, (suffix, write) in enumerate(FLOATS.values()):
        write(whole := tmp_path / f"{k}{suffix}", float_image())
        data = whole.read_bytes()
        changed = []
        for at in random.integers(0, len(data), 30):
            changed.append(data[:at] + bytes([int(random.integers(256))]) + data[at + 1 :])
        for content in (b"", b"no image", data[: len(data) // 2], data[:20], *changed):
            whole.write_bytes(content)
            try:
                assert read_depth(whole).ndim == 2
            except FrameError as error:
                assert str(error).startswith(str(whole)) and "\n" not in str(error)


def test_a_header_that_claims_too_much_asks_for_no_memory(tmp_path: Path) -> None:
    for name in ("0.npy", "1.npz"):
        path, header = tmp_path / name, b"{'descr': '<f8', 'fortran_order': False, 'shape': (1000000, 1000000), }"
        data = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header
        if name.endswith("npz"):
            with zipfile.ZipFile(path, "w") as archive:
                archive.writestr("depth.npy", data)
        else:
            path.write_bytes(data)
        with pytest.raises(FrameError, match=r"an array of \(1000000, 1000000\) float64, expected the numbers of one depth image"):
            read_depth(path)


@pytest.mark.parametrize(("suffix", "module"), [(".exr", "OpenEXR"), (".h5", "h5py")])
def test_a_missing_package_is_named(suffix: str, module: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    path = with_depth(tmp_path / "room", suffix, lambda file, _: file.write_bytes(b"\x89HDF\r\n\x1a\n"), float_image())
    with pytest.raises(ConfigError, match=rf"needs {module}: .*-m pip install {module}$"):
        open_recording(path)


@pytest.mark.parametrize("shape", [(1, HEIGHT, WIDTH), (HEIGHT, WIDTH, 1)])
def test_one_channel_may_be_an_axis_of_its_own(shape: tuple[int, ...]) -> None:
    assert as_depth(np.ones(shape, np.uint16), "depth").shape == (HEIGHT, WIDTH)
    with pytest.raises(FrameError, match="3 channel"):
        as_depth(np.ones((HEIGHT, WIDTH, 3), np.float32), "depth")


def test_several_arrays_need_a_name(tmp_path: Path) -> None:
    np.savez(tmp_path / "0.npz", first=np.ones((2, 2)), second=np.ones((2, 2)))
    with pytest.raises(FrameError, match=r"0\.npz: holds first, second, expected one array named depth"):
        read_depth(tmp_path / "0.npz")
