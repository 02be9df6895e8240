"""What is fuzzed: for each kind of file that is read, a small valid one and the function that uses it."""

import json
import shutil
import tarfile
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from helpers import array_recordings, phones, posed_recordings, recordings, ros_bags, videos
from idfslam.batch.batch_file import read_batch
from idfslam.config import FAST, load
from idfslam.datasets import open_recording
from idfslam.downloads.download import read_ledger
from idfslam.errors import FrameError, IdfSlamError
from idfslam.geometry.trajectory import load_tum
from idfslam.pictures.camera_paths import load_poses
from idfslam.runs.evaluate_run import load_mesh
from idfslam.runs.finished_run import FinishedRun
from idfslam.runs.metrics import ate_rmse, headline, read_metrics
from idfslam.runs.run_config import read_config
from idfslam.storage.unpack import unpack

MOST_FRAMES = 8  # that are read of a recording
_ARRAYS = ("npy", "npz", "tiff", "mat", "pfm", "h5", "exr", "pgm")
_OPEN3D = '{"width": 16, "height": 12, "intrinsic_matrix": [15, 0, 0, 0, 15, 0, 7.5, 5.5, 1]}'
_ROS = """image_width: 16
image_height: 12
camera_matrix: {rows: 3, cols: 3, data: [15, 0, 7.5, 0, 15, 5.5, 0, 0, 1]}
distortion_coefficients: {rows: 1, cols: 5, data: [0.1, 0, 0, 0, 0]}
"""
_CAMERA_FILES = {"camera_intrinsic.json": _OPEN3D, "camera_info.yaml": _ROS, "cameras.txt": "1 PINHOLE 16 12 15 15 8 6\n"}
_CONFIG = """seed: 3
preset: fast
mapper: {pixels: 64, learning_rate: 0.01}
tracker:
  weights: null
mesh:
  resolution: 0.02
recording:
  path: tiny
"""


@dataclass(frozen=True)
class Target:
    """One kind of file or folder."""

    name: str
    make: Callable[[Path], Path]  # writes the valid files into an empty folder, and returns the path that is used
    use: Callable[[Path], object]
    share: float = 1.0  # of the mutations, compared with other targets
    files: str = "**/*"  # those that are damaged


def read_all(path: Path, **options: Any) -> None:
    """Opens a recording and reads its frames; one that cannot be read is no fault."""
    recording = open_recording(path, **options)
    assert np.isfinite(recording.timestamps).all(), "a time stamp is not finite"
    truth = recording.ground_truth
    assert truth is None or truth.shape == (len(recording), 4, 4), "the truth is not of these frames"
    for i in range(min(len(recording), MOST_FRAMES)):
        try:
            recording[i]
        except FrameError:
            continue


def use_run(folder: Path) -> None:
    """Reads all results of a run, as export, report, eval and view do."""
    refused: IdfSlamError | None = None
    for read in (_read_config, _read_metrics, *(partial(_read_part, name=name) for name in ("frames", "keyframes", "trajectory"))):
        try:
            read(folder)
        except IdfSlamError as error:
            refused = error
    if refused is not None:
        raise refused


def _read_part(folder: Path, name: str) -> object:
    return getattr(FinishedRun(folder), name)


def _read_config(folder: Path) -> None:
    _, source = read_config(folder)
    if source is not None:
        open_recording(source.path, **{name: value for name, value in vars(source).items() if name != "path"})


def _read_metrics(folder: Path) -> None:
    metrics = read_metrics(folder)
    if "frames" in metrics and "frames_per_second" in metrics:
        headline(metrics["frames"], metrics["frames_per_second"], ate_rmse(metrics))


def _array_recording(folder: Path, kind: str) -> Path:
    path = recordings.write_folder(folder / "r", frames=2)
    for i in range(2):
        (path / f"depth/{i:06d}.png").unlink()
        depth = np.full((recordings.HEIGHT, recordings.WIDTH), 1.0, np.float32)
        file = path / f"depth/{i:06d}.{kind}"
        if kind == "npy":
            np.save(file, depth)
        elif kind == "npz":
            np.savez(file, depth=depth)
        elif kind == "tiff":
            cv2.imwrite(str(file), depth)
        elif kind == "mat":
            from scipy.io import savemat

            savemat(file, {"depth": depth})
        elif kind == "h5":
            import h5py

            with h5py.File(file, "w") as opened:
                opened["depth"] = depth
        elif kind == "exr":
            import OpenEXR

            OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}, {"Z": depth}).write(str(file))
        elif kind == "pgm":
            cv2.imwrite(str(file), recordings.depth_image(1000))
        elif kind == "pfm":
            file.write_bytes(b"Pf\n16 12\n-1.0\n" + depth.tobytes())
    return path


def _with_stamps(folder: Path) -> Path:
    path = recordings.write_folder(folder / "r", frames=2)
    (path / "timestamps.txt").write_text("# number timestamp depth_timestamp\n0 0.0 0.01\n1 0.1 0.11\n")
    return path


def _with_cam_params(folder: Path) -> Path:
    path = recordings.write_folder(folder / "r", frames=2)
    camera = {"w": 16, "h": 12, "fx": 15, "fy": 15, "cx": 7.5, "cy": 5.5, "scale": 1000, "distortion": [0.1, 0, 0, 0]}
    camera |= {"readout": 0.026, "depth_readout": 0.03, "depth_delay": -0.009}
    T = np.eye(4).tolist()
    (path / "cam_params.json").write_text(json.dumps({"camera": camera, "depth_camera": camera, "T_colour_depth": T}))
    return path


def _camera_file(folder: Path, name: str) -> Path:
    path = recordings.write_folder(folder / "r", frames=2)
    (path / "intrinsics.txt").unlink()
    return _text(name, _CAMERA_FILES[name], path).parent


def _unpacked_record3d(folder: Path) -> Path:
    for name, data in phones.record3d_entries(2).items():
        (folder / "r" / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / "r" / name).write_bytes(data)
    return folder / "r"


def _kinect(folder: Path) -> Path:
    depth = np.full((288, 320), 1000, np.uint16)
    return videos.write_kinect(folder / "k.mkv", calibration=videos.kinect_calibration(), frames=1, size=(64, 48), depth=depth)


def _video_folder(folder: Path) -> Path:
    path = folder / "r"
    videos.write_video(path / "rgb.mp4", frames=2)
    (path / "depth").mkdir()
    for i in range(2):
        cv2.imwrite(str(path / f"depth/{i}.png"), np.full((48, 64), 1000, np.uint16))
    (path / "intrinsics.txt").write_text("60 0 31.5\n0 60 23.5\n0 0 1\n")
    return path


def _bag(folder: Path, storage: str) -> Path:
    return ros_bags.write_bag(folder / ("r.bag" if storage == "ros1" else "r"), ros_bags.recorded(1), storage)


def _compressed_bag(folder: Path) -> Path:
    depth = np.full((recordings.HEIGHT, recordings.WIDTH), 1.0)
    colour = cv2.imencode(".jpg", recordings.colour_image(0))[1].tobytes()
    messages = [
        (ros_bags.INFO, 0.9, ros_bags.camera_info()),
        ("/camera/color/image_raw/compressed", 1.0, ros_bags.compressed(colour, "rgb8; jpeg compressed bgr8", 1.0)),
        ("/camera/aligned_depth_to_color/image_raw/compressedDepth", 1.0, ros_bags.compressed_depth(depth, 1.0, encoding="32FC1")),
    ]
    return ros_bags.write_bag(folder / "r.bag", messages, "ros1")


def _run(folder: Path) -> Path:
    """A result folder but for its map and its mesh, which are targets of their own."""
    from fuzz import small_run

    return small_run.write(folder / "run", recordings.write_folder(folder / "recording", frames=2))


def _map(folder: Path) -> Path:
    from fuzz import small_run

    return small_run.write_map(folder / "map.safetensors")


def _weights(folder: Path) -> Path:
    from idfslam.tracking import features

    return Path(shutil.copy(Path(features.__file__).parent / "weights/extractor.safetensors", folder / "weights.safetensors"))


def _decoders(folder: Path) -> Path:
    from idfslam import mapping

    return Path(shutil.copy(Path(mapping.__file__).parent / "weights/occupancy_decoders.safetensors", folder / "w.safetensors"))


def _checkpoint(folder: Path) -> Path:
    from fuzz import small_run

    return small_run.write_checkpoint(folder)


def _read_map(path: Path) -> object:
    from idfslam.mapping.saved_map import load_map

    return load_map(path)


def _image_archive(folder: Path) -> Path:
    from fuzz import small_run

    return small_run.write_archive(folder / "archive.safetensors")


def _read_image_archive(path: Path) -> object:
    from idfslam.views.image_archive import load_archive

    archive = load_archive(path)
    return [archive.colour(i) for i in range(len(archive.views))], archive.depths


def _read_weights(path: Path) -> object:
    from idfslam.tracking.features import load_extractor

    return load_extractor(path)


def _read_decoders(path: Path) -> object:
    from idfslam.config import OccupancyGridsConfig
    from idfslam.mapping.joint.occupancy_grids import OccupancyGrids

    return OccupancyGrids(OccupancyGridsConfig(table_log2=6)).load_decoders(path)


def _read_checkpoint(folder: Path) -> object:
    from fuzz import small_run

    return small_run.read_checkpoint(folder)


def _text(name: str, text: str, folder: Path) -> Path:
    (folder / name).write_text(text)
    return folder / name


def _list(name: str, folder: Path) -> Path:
    recordings.write_folder(folder / "room", frames=2)
    text = (
        'room frames=2 camera.fx=525 seed=3\n"room" out=again mapper.pixels=256 format=folder\nsynthetic:3:kinect@5 start=1\nkidnap:room\n'
    )
    yaml = "- room\n- {path: room, frames: 2, camera: {fx: 525}, mapper.pixels: 256, out: b}\n- path: synthetic:1@3\n  seed: 1\n"
    return _text(name, text if name.endswith("txt") else yaml, folder)


def _zip(folder: Path) -> Path:
    with zipfile.ZipFile(folder / "a.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a/x.txt", b"hi" * 30)
        archive.writestr("a/seq.zip", _inner_zip(folder))
        archive.writestr("a/z", b"q" * 400, zipfile.ZIP_STORED)
        archive.writestr("a/b", b"q" * 400, zipfile.ZIP_BZIP2)
        archive.writestr("a/l", b"q" * 400, zipfile.ZIP_LZMA)
    return folder / "a.zip"


def _inner_zip(folder: Path) -> bytes:
    with zipfile.ZipFile(folder / "inner.zip", "w") as archive:
        archive.writestr("y.txt", b"hello")
    data = (folder / "inner.zip").read_bytes()
    (folder / "inner.zip").unlink()
    return data


def _tar(mode: str, folder: Path) -> Path:
    file = folder / "x.txt"
    file.write_bytes(b"hi" * 30)
    with tarfile.open(folder / "a.tar", f"w:{mode}") as archive:
        archive.add(file, "a/x.txt")
        archive.add(file, "a/" + "n" * 120)
    file.unlink()
    return folder / "a.tar"


def _unpack(path: Path) -> None:
    out = path.parent / "out"
    try:
        unpack(path, out)
        escaped = [entry for entry in path.parent.iterdir() if entry not in (path, out)]
        assert not escaped, f"unpacked outside its folder: {escaped}"
    finally:
        if out.is_dir():
            shutil.rmtree(out)
        else:
            out.unlink(missing_ok=True)


def _mesh(folder: Path) -> Path:
    import trimesh

    trimesh.creation.box().export(folder / "mesh.ply")
    return folder / "mesh.ply"


def _poses(folder: Path) -> Path:
    return _text("poses.txt", "# t x y z\n" + "".join(recordings.freiburg(f"{i}.5", i) + "\n" for i in range(3)), folder)


def _kitti(folder: Path) -> Path:
    return _text("poses.txt", "".join(" ".join(f"{x:.6g}" for x in recordings.pose(i)[:3].ravel()) + "\n" for i in range(3)), folder)


def _transforms(folder: Path) -> Path:
    frames = [{"file_path": f"images/{i}.png", "transform_matrix": recordings.pose(i).tolist()} for i in range(2)]
    return _text("transforms.json", json.dumps({"fl_x": 15, "fl_y": 15, "cx": 8, "cy": 6, "w": 16, "h": 12, "frames": frames}), folder)


def _ledger(folder: Path) -> Path:
    _text("downloads.json", json.dumps({"tum/desk": {"url": "http://x", "bytes": 5, "sha256": "0" * 64, "date": "2026-01-01"}}), folder)
    return folder


def _recording(name: str, make: Callable[[Path], Path], share: float = 1.0, files: str = "**/*", **options: Any) -> Target:
    return Target(name, make, partial(read_all, **options), share, files)


def _two(write: Callable[..., Path], **options: Any) -> Callable[[Path], Path]:
    return lambda folder: write(folder / "r", frames=2, **options)


def _arrays(folder: Path, write: Callable[..., Path]) -> Path:
    return write(folder / "r", depths=array_recordings.DEPTH, images=array_recordings.RGB, K=array_recordings.K)


def _zipped(folder: Path) -> Path:
    recordings.write_folder(folder / "r", frames=2)
    archive = shutil.make_archive(str(folder / "r"), "zip", folder / "r")
    shutil.rmtree(folder / "r")
    return Path(archive)


_POSED: dict[str, Callable[..., Path]] = {
    "transforms": posed_recordings.write_nerfstudio,
    "polycam": posed_recordings.write_polycam,
    "3d scanner app": posed_recordings.write_scanner_app,
    "frame lines": posed_recordings.write_frame_lines,
}
_ARRAY_FILES: dict[str, Callable[..., Path]] = {
    "hdf5": array_recordings.write_hdf5,
    "npz": array_recordings.write_npz,
    "mat": array_recordings.write_mat,
    "mat 7.3": array_recordings.write_mat_73,
}

TARGETS: dict[str, Target] = {
    target.name: target
    for target in (
        _recording("folder", _two(recordings.write_folder)),
        _recording("folder, stamps", _with_stamps, files="r/*.txt"),
        _recording("folder, camera", _with_cam_params, files="r/*.json"),
        *(_recording(f"folder, {name}", partial(_camera_file, name=name), 0.5, f"r/{name}") for name in _CAMERA_FILES),
        *(_recording(f"folder, {kind}", partial(_array_recording, kind=kind), 0.5, "r/depth/*") for kind in _ARRAYS),
        _recording("tum", _two(recordings.write_tum)),
        _recording("tum, lists", _two(recordings.write_tum), files="r/*.txt"),
        _recording("icl", _two(recordings.write_icl_nuim)),
        _recording("icl, lists", _two(recordings.write_icl_nuim), files="r/*.*"),
        _recording("replica", _two(recordings.write_replica)),
        _recording("replica, poses", _two(recordings.write_replica), files="r/*.*"),
        _recording("7scenes", _two(recordings.write_seven_scenes)),
        _recording("scannet", _two(recordings.write_scannet, cam_params=False)),
        _recording("sens", lambda folder: recordings.write_sens(folder / "a.sens", frames=2), 2.0),
        _recording("sens, raw", lambda folder: recordings.write_sens(folder / "a.sens", frames=2, colour_codec="raw", depth_codec="raw")),
        _recording("sens, png", lambda folder: recordings.write_sens(folder / "a.sens", frames=2, colour_codec="png")),
        _recording("stray", _two(phones.write_stray, cameras=True)),
        _recording("stray, text", _two(phones.write_stray, cameras=True), files="r/*.csv"),
        _recording("record3d", lambda folder: phones.write_record3d(folder / "a.r3d", phones.record3d_entries(2))),
        _recording("record3d, unpacked", _unpacked_record3d),
        _recording("record3d, metadata", _unpacked_record3d, files="r/metadata"),
        _recording("azure kinect", _kinect, 0.3),
        *(_recording(name, _two(write)) for name, write in _POSED.items()),
        *(_recording(f"{name}, text", _two(write), files="r/**/*.json*") for name, write in _POSED.items()),
        *(_recording(f"arrays, {name}", partial(_arrays, write=write), 0.5, "r.*") for name, write in _ARRAY_FILES.items()),
        _recording("recording in a zip", _zipped, 0.5),
        _recording("video folder", _video_folder, 0.5),
        _recording("video folder, video", _video_folder, 0.5, files="r/*.mp4"),
        _recording("ros1", partial(_bag, storage="ros1"), 0.3),
        _recording("ros1, compressed", _compressed_bag, 0.3),
        _recording("ros2 sqlite", partial(_bag, storage="sqlite3"), 0.3),
        _recording("ros2 mcap", partial(_bag, storage="mcap"), 0.3),
        Target("config.yaml", partial(_text, "config.yaml", _CONFIG), load, 2.0),
        Target("result folder", _run, use_run, 1.0, "run/*"),
        Target("map.safetensors", _map, _read_map, 0.3),
        Target("archive.safetensors", _image_archive, _read_image_archive, 0.3),
        Target("weights", _weights, _read_weights, 0.3),
        Target("decoders", _decoders, _read_decoders, 0.3),
        Target("checkpoint", _checkpoint, _read_checkpoint, 0.3),
        Target("mesh.ply", _mesh, load_mesh),
        Target("batch list, text", partial(_list, "list.txt"), lambda path: read_batch([str(path)], FAST), 1.0, "*.txt"),
        Target("batch list, yaml", partial(_list, "list.yaml"), lambda path: read_batch([str(path)], FAST), 1.0, "*.yaml"),
        Target("zip", _zip, _unpack),
        *(Target(f"tar {mode}".strip(), partial(_tar, mode), _unpack) for mode in ("", "gz", "bz2", "xz")),
        Target("downloads.json", _ledger, read_ledger, 0.5, "*.json"),
        Target("poses, tum", _poses, load_tum),
        Target("poses, any", _kitti, load_poses),
        Target("poses, transforms.json", _transforms, load_poses),
    )
}  # fmt: skip
