"""Frames from one process to another through a pipe, so that every peer gets the same bytes and none reads files.

A line of JSON with camera and number of frames; then for each frame a line of JSON, and behind it colour (H, W, 3) uint8 RGB and depth
(H, W) float32 [m], 0 = no reading. Only numpy is needed to read it.
"""

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import IO

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class StreamHeader:
    """What holds for all frames: size [px], pinhole camera [px], number of frames."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    frames: int


@dataclass(frozen=True, eq=False)
class StreamFrame:
    """A frame as a peer gets it."""

    timestamp: float  # [s]
    colour: NDArray[np.uint8]  # (H, W, 3) RGB
    depth: NDArray[np.float32]  # (H, W) [m]
    T_wc: NDArray[np.float64] | None = None  # (4, 4), where poses are given


def write_header(pipe: IO[bytes], header: StreamHeader) -> None:
    """Begins a stream."""
    pipe.write(json.dumps(asdict(header)).encode() + b"\n")


def write_frame(pipe: IO[bytes], frame: StreamFrame) -> None:
    """Adds a frame."""
    values = {"timestamp": frame.timestamp, "T_wc": None if frame.T_wc is None else frame.T_wc.tolist()}
    pipe.write(json.dumps(values).encode() + b"\n")
    pipe.write(np.ascontiguousarray(frame.colour, np.uint8).tobytes())
    pipe.write(np.ascontiguousarray(frame.depth, np.float32).tobytes())


def read_header(pipe: IO[bytes]) -> StreamHeader:
    """The beginning of a stream."""
    return StreamHeader(**json.loads(pipe.readline()))


def read_frames(pipe: IO[bytes], header: StreamHeader) -> Iterator[StreamFrame]:
    """The frames of a stream. Raises EOFError if it ends before all of them."""
    shape = header.height, header.width
    for _ in range(header.frames):
        values = json.loads(pipe.readline() or b"null")
        colour, depth = pipe.read(3 * shape[0] * shape[1]), pipe.read(4 * shape[0] * shape[1])
        if values is None or len(depth) < 4 * shape[0] * shape[1]:
            raise EOFError("the stream of frames ended early")
        T_wc = None if values["T_wc"] is None else np.array(values["T_wc"])
        images = np.frombuffer(colour, np.uint8).reshape(*shape, 3), np.frombuffer(depth, np.float32).reshape(shape)
        yield StreamFrame(values["timestamp"], *images, T_wc)
