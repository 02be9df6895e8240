"""ScanNet (Dai et al., CVPR 2017): exported (color/, depth/, pose/, intrinsic/) or raw (.sens, version 4); depth in millimetres.

Colour images are larger than depth images: they are resampled to the depth camera's image. A pose of inf or nan means no pose.
"""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from idfslam.datasets.cameras.calibration import Calibration
from idfslam.datasets.cameras.camera_files import read_camera_file
from idfslam.datasets.images.decoding import Depth, ImageFiles, numbered, read_depth
from idfslam.datasets.images.depth_units import usual_scale
from idfslam.datasets.images.pairs import paired
from idfslam.datasets.near_miss import Likeness, part
from idfslam.datasets.poses.truth import Truth
from idfslam.datasets.provenance import ASSUMED, STATED
from idfslam.datasets.readers.folder import read_poses
from idfslam.datasets.readers.sens_file import SensImages, read_sens_index
from idfslam.datasets.recording import FPS, Reader, ReadImages, Recording, regular_stamps
from idfslam.errors import FrameError, RecordingError
from idfslam.geometry.sensor_timing import LONGEST


def is_exported(path: Path) -> bool:
    return all((path / name).is_dir() for name in ("color", "depth", "intrinsic"))


def is_raw(path: Path) -> bool:
    """Whether it is a .sens file, or a folder with one."""
    return path.suffix == ".sens" if path.is_file() else any(path.glob("*.sens"))


def open_scannet(path: Path, stated: Calibration) -> Recording:
    """Opens a .sens file, a folder with one, or an exported folder (preferred if both are there)."""
    if path.is_dir() and (path / "color").is_dir():
        return _open_exported(path, stated)
    files = [path] if path.is_file() else sorted(path.glob("*.sens"))
    if len(files) != 1:
        raise RecordingError(f"{path}: {len(files)} .sens files, expected color/, depth/ and intrinsic/ or one .sens file: name one")
    return _open_sens(files[0], stated)


def _open_exported(path: Path, stated: Calibration) -> Recording:
    pairs = paired(numbered(path / "color"), numbered(path / "depth"), path)
    depth = read_camera_file(path / "intrinsic", ("intrinsic_depth.txt",))
    colour = read_camera_file(path / "intrinsic", ("intrinsic_color.txt",))
    size = None if pairs.has_depth.all() else _depth_size([file for _, file in pairs.files if file is not None])
    read: ReadImages = ColourOnDepth(ImageFiles(pairs.files), None if stated.complete else colour, depth, size)
    return Recording(
        path.name,
        read,
        timestamps=pairs.places / FPS,
        depth_timestamps=pairs.depth_timestamps(pairs.places / FPS),
        stamps_source=ASSUMED,
        ground_truth=lambda: read_poses(path, pairs, pairs.places / FPS),
        calibration=stated.over(depth).over(usual_scale(pairs.files, why="ScanNet layout")),
    )


def _depth_size(files: list[Path]) -> tuple[int, int]:
    """Width and height [px] of the first readable depth image. Raises RecordingError if there is none."""
    first: FrameError | None = None
    for file in files:
        try:
            height, width = read_depth(file).shape
        except FrameError as error:
            first = first or error
        else:
            return width, height
    raise RecordingError(str(first)) from first


@dataclass(frozen=True)
class ColourOnDepth:
    """Called with i, returns colour resampled to the depth camera's image, and depth; None where there is none.

    The two cameras are assumed to share their centre (ScanNet's extrinsics are the identity), so that the warp is affine.
    """

    read: ReadImages
    colour: Calibration | None  # None: colour and depth show the same field of view in different sizes
    depth: Calibration
    size: tuple[int, int] | None = None  # width, height [px] of depth, for frames without a depth image

    def __call__(self, i: int) -> tuple[NDArray[np.uint8], Depth | None]:
        bgr, raw = self.read(i)
        height, width = bgr.shape[:2]
        size: tuple[int, int] = (raw.shape[1], raw.shape[0]) if raw is not None else self.size or (width, height)
        if (width, height) != size:
            shrinks = width > size[0]
            bgr = np.asarray(cv2.resize(bgr, size, interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR), np.uint8)
        if self.colour is None or not (self.colour.complete and self.depth.complete):
            return bgr, raw
        source = self.colour.camera(width, height, "intrinsic_color").resized(*size)
        target = self.depth.camera(*size, "intrinsic_depth")
        x, y = source.fx / target.fx, source.fy / target.fy
        A = np.array([[x, 0, source.cx - x * target.cx], [0, y, source.cy - y * target.cy]])  # depth pixel -> colour pixel
        corners = np.array([[0, 0, 1], [*size, 1]])
        if np.abs(corners @ A.T - corners[:, :2]).max() < 0.5:  # less than half a pixel everywhere: not worth the blur
            return bgr, raw
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        return np.asarray(cv2.warpAffine(bgr, A, size, flags=flags, borderMode=cv2.BORDER_REPLICATE), np.uint8), raw


def _open_sens(path: Path, stated: Calibration) -> Recording:
    header, frames = read_sens_index(path)
    stamps, depth_stamps = (np.array([getattr(frame, name) for frame in frames]) for name in ("stamp", "depth_stamp"))
    truth = np.stack([frame.T_wc for frame in frames])
    has_truth = np.isfinite(truth).all((1, 2)).any()
    warp = None if stated.complete else header.colour
    increasing = bool(np.all(np.diff(stamps) > 0))
    one_clock = increasing and bool(np.all(np.abs(depth_stamps - stamps) < LONGEST))
    return Recording(
        path.stem,
        ColourOnDepth(SensImages(path, header, frames), warp, header.depth),
        timestamps=stamps if increasing else regular_stamps(len(frames)),
        depth_timestamps=depth_stamps if one_clock else None,
        stamps_source=STATED if increasing else ASSUMED,
        ground_truth=(lambda: Truth(truth, str(path))) if has_truth else None,
        calibration=stated.over(header.depth),
    )


EXPORTED = Reader(
    "scannet",
    "color/, depth/, intrinsic/",
    is_exported,
    open_scannet,
    likeness=Likeness("an exported ScanNet scene", (part("color", "color/"), part("depth", "depth/"), part("intrinsic", "intrinsic/"))),
)
RAW = Reader("scannet", "a .sens file", is_raw, open_scannet)  # without a likeness: what lies beside a file is no part of it
