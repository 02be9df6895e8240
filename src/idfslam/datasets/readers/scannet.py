"""ScanNet (Dai et al., CVPR 2017): exported (color/, depth/, pose/, intrinsic/) or raw (.sens, version 4); depth in millimetres.

Colour images are larger than depth images: they are resampled to the depth camera's image. A pose of inf or nan means no pose.
"""

import struct
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import cv2
import numpy as np
from numpy.typing import NDArray

from idfslam.datasets.cameras.calibration import Calibration
from idfslam.datasets.cameras.camera_files import read_camera_file
from idfslam.datasets.images.decoding import Depth, ImageFiles, decode_colour, numbered, read_depth
from idfslam.datasets.images.depth_units import usual_scale
from idfslam.datasets.images.image_header import LONGEST_SIDE
from idfslam.datasets.images.pairs import paired
from idfslam.datasets.near_miss import Likeness, part
from idfslam.datasets.poses.truth import Truth
from idfslam.datasets.provenance import ASSUMED, STATED
from idfslam.datasets.readers.folder import read_poses
from idfslam.datasets.recording import FPS, Reader, ReadImages, Recording, regular_stamps
from idfslam.errors import FrameError, RecordingError
from idfslam.geometry.sensor_timing import LONGEST

_VERSION = 4  # of .sens files; all published ones have it: a fact of the format
_COLOUR_CODECS = {0: "raw", 1: "png", 2: "jpeg"}
_DEPTH_CODECS = {0: "raw", 1: "zlib"}  # 2 is "occi", which no published recording uses
_FRAME = struct.Struct("<16f4Q")  # camera-to-world, stamps of colour and depth [us], bytes of colour and depth


def recognises(path: Path) -> bool:
    if path.is_file():
        return path.suffix == ".sens"
    exported = all((path / name).is_dir() for name in ("color", "depth", "intrinsic"))
    return exported or any(path.glob("*.sens"))


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


@dataclass(frozen=True)
class SensHeader:
    """The header of a .sens file."""

    colour: Calibration
    depth: Calibration
    colour_codec: str
    depth_codec: str
    frames: int


@dataclass(frozen=True)
class SensFrame:
    """The position of one frame in a .sens file, its stamp and pose."""

    offset: int  # [bytes] of its colour image; its depth image follows
    colour_bytes: int
    depth_bytes: int
    stamp: float  # [s] of colour
    depth_stamp: float  # [s]
    T_wc: NDArray[np.float64]  # (4, 4)


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


def read_sens_index(path: Path) -> tuple[SensHeader, list[SensFrame]]:
    """Reads the header and the positions of all frames, but no images; raises RecordingError if the file is malformed."""
    size = path.stat().st_size
    with path.open("rb") as file:
        header = _read_header(file, path)
        if not header.frames:
            raise RecordingError(f"{path}: holds no frames, expected a recording: copy it again")
        frames = []
        for i in range(header.frames):
            data = file.read(_FRAME.size)
            if len(data) == _FRAME.size:
                *pose, stamp, depth_stamp, colour_bytes, depth_bytes = _FRAME.unpack(data)
                stamps = stamp / 1e6, depth_stamp / 1e6
                frame = SensFrame(file.tell(), colour_bytes, depth_bytes, *stamps, np.array(pose).reshape(4, 4))
                end = frame.offset + colour_bytes + depth_bytes
            if len(data) < _FRAME.size or end > size:
                raise RecordingError(f"{path}: cut off in frame {i} of {header.frames} ({size} bytes): copy the recording again")
            frames.append(frame)
            file.seek(end)
    return header, frames


def _read_header(file: BinaryIO, path: Path) -> SensHeader:
    def take(layout: str) -> tuple[float, ...]:
        data = file.read(struct.calcsize(layout))
        if len(data) < struct.calcsize(layout):
            raise RecordingError(f"{path}: cut off in its header, expected a .sens file of version {_VERSION}")
        return struct.unpack(layout, data)

    version, length = take("<IQ")
    if version != _VERSION or length > 4096:
        raise RecordingError(f"{path}: .sens version {int(version)}, expected {_VERSION}: not a ScanNet recording, or another version")
    file.seek(int(length), 1)  # the sensor's name
    K_colour, _, K_depth, _ = (np.array(take("<16f")).reshape(4, 4) for _ in range(4))  # each followed by its extrinsics
    colour_codec, depth_codec = (int(code) for code in take("<2i"))
    colour_width, colour_height, depth_width, depth_height = (int(length) for length in take("<4I"))
    scale, frames = take("<fQ")
    if colour_codec not in _COLOUR_CODECS or depth_codec not in _DEPTH_CODECS:
        found = f"colour compression {colour_codec}, depth compression {depth_codec}"
        raise RecordingError(f"{path}: {found}, expected raw, png or jpeg colour (0-2) and raw or zlib depth (0, 1): export the recording")
    if max(colour_width, colour_height, depth_width, depth_height) > LONGEST_SIDE:
        found = f"colour {colour_width}x{colour_height}, depth {depth_width}x{depth_height}"
        raise RecordingError(f"{path}: {found}, expected at most {LONGEST_SIDE} pixels a side: copy the recording again")
    return SensHeader(
        _calibration(K_colour, colour_width, colour_height, None, path),
        _calibration(K_depth, depth_width, depth_height, scale, path),
        _COLOUR_CODECS[colour_codec],
        _DEPTH_CODECS[depth_codec],
        int(frames),
    )


def _calibration(K: NDArray[np.float64], width: int, height: int, scale: float | None, path: Path) -> Calibration:
    fx, fy, cx, cy = (float(value) for value in K[[0, 1, 0, 1], [0, 1, 2, 2]])
    return Calibration(fx, fy, cx, cy, width, height, depth_scale=scale, source=str(path))


@dataclass(frozen=True)
class SensImages:
    """Called with i, returns colour (H, W, 3) uint8 BGR and depth (H, W) uint16 of frame i, each at its own size."""

    path: Path
    header: SensHeader
    frames: list[SensFrame]

    def __call__(self, i: int) -> tuple[NDArray[np.uint8], NDArray[np.uint16]]:
        frame, source = self.frames[i], f"{self.path}: frame {i}"
        try:
            with self.path.open("rb") as file:  # opened for each frame, so that threads can read at once
                file.seek(frame.offset)
                colour, depth = file.read(frame.colour_bytes), file.read(frame.depth_bytes)
        except OSError as error:
            raise FrameError(f"{source}: {error.strerror}") from error
        return self._colour(colour, source), self._depth(depth, source)

    def _colour(self, data: bytes, source: str) -> NDArray[np.uint8]:
        if self.header.colour_codec != "raw":
            return decode_colour(data, source)
        height, width = self.header.colour.height or 0, self.header.colour.width or 0
        if len(data) != height * width * 3:
            raise FrameError(f"{source}: {len(data)} bytes of colour, expected {height * width * 3}: copy the recording again")
        return np.frombuffer(data, np.uint8).reshape(height, width, 3)[..., ::-1]

    def _depth(self, data: bytes, source: str) -> NDArray[np.uint16]:
        height, width = self.header.depth.height or 0, self.header.depth.width or 0
        try:  # a byte more than expected tells that there are more
            raw = zlib.decompressobj().decompress(data, height * width * 2 + 1) if self.header.depth_codec == "zlib" else data
        except zlib.error as error:
            raise FrameError(f"{source}: depth cannot be unpacked ({error}): copy the recording again") from error
        if len(raw) != height * width * 2:
            raise FrameError(f"{source}: {len(raw)} bytes of depth, expected {height * width * 2}: copy the recording again")
        return np.frombuffer(raw, "<u2").reshape(height, width)


READER = Reader(
    "scannet",
    "color/, depth/, intrinsic/ or a .sens file",
    recognises,
    open_scannet,
    likeness=Likeness("an exported ScanNet scene", (part("color", "color/"), part("depth", "depth/"), part("intrinsic", "intrinsic/"))),
)
