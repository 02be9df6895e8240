"""The .sens files of ScanNet, version 4: a header, and each frame with its pose, its stamps and its two compressed images."""

import struct
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from idfslam.datasets.cameras.calibration import Calibration
from idfslam.datasets.images.decoding import decode_colour
from idfslam.datasets.images.image_header import LONGEST_SIDE
from idfslam.errors import FrameError, RecordingError

_VERSION = 4  # of .sens files; all published ones have it: a fact of the format
_LONGEST_NAME = 4096  # letters of the sensor's name in a .sens file; raised, damaged files are read further. Chosen by hand
_COLOUR_CODECS = {0: "raw", 1: "png", 2: "jpeg"}
_DEPTH_CODECS = {0: "raw", 1: "zlib"}  # 2 is "occi", which no published recording uses
_FRAME = struct.Struct("<16f4Q")  # camera-to-world, stamps of colour and depth [us], bytes of colour and depth


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
    if version != _VERSION:
        raise RecordingError(f"{path}: .sens version {int(version)}, expected {_VERSION}: not a ScanNet recording, or another version")
    if length > _LONGEST_NAME:
        raise RecordingError(f"{path}: the sensor's name has {int(length)} letters, expected a ScanNet recording: copy it again")
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
