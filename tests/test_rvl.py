"""RVL: a plain encoder after the paper, alone and in a bag; damaged streams."""

import struct
from pathlib import Path

import numpy as np
import pytest

from helpers.recordings import HEIGHT, WIDTH, depth_image
from helpers.ros_bags import COLOUR, DEPTH, INFO, camera_info, colour_image, compressed, image, write_bag
from idfslam.datasets import open_recording
from idfslam.datasets.ros.rvl import decode_rvl
from idfslam.errors import FrameError, RecordingError


def encode_rvl(depth: np.ndarray) -> bytes:
    """Wilson, "Fast lossless depth image compression", listing 1."""
    nibbles: list[int] = []

    def put(value: int) -> None:
        while True:
            value, low = value >> 3, value & 7
            nibbles.append(low | (8 if value else 0))
            if not value:
                return

    pixels, i, previous = depth.ravel().tolist(), 0, 0
    while i < len(pixels):
        for empty in (True, False):
            start = i
            while i < len(pixels) and (pixels[i] == 0) == empty:
                i += 1
            put(i - start)
        for value in pixels[start:i]:
            difference = value - previous
            put(2 * difference if difference >= 0 else -2 * difference - 1)
            previous = value
    nibbles += [0] * (-len(nibbles) % 8)
    words = [sum(nibble << (28 - 4 * k) for k, nibble in enumerate(nibbles[at : at + 8])) for at in range(0, len(nibbles), 8)]
    return struct.pack(f"<II{len(words)}I", depth.shape[1], depth.shape[0], *words)


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_decoding_undoes_encoding(share: float) -> None:
    random = np.random.default_rng(1)
    for dtype_range in ((500, 520), (1, 65536)):
        depth = random.integers(*dtype_range, (24, 40)).astype(np.uint16)
        depth[random.random(depth.shape) < share] = 0
        np.testing.assert_array_equal(decode_rvl(encode_rvl(depth), "depth"), depth)


def test_damaged_streams_are_frame_errors_or_images() -> None:
    random = np.random.default_rng(2)
    whole = encode_rvl(random.integers(0, 900, (24, 40)).astype(np.uint16))
    for data in (
        b"",
        whole[:8],
        whole[:-40],
        struct.pack("<II", 0, 5),
        struct.pack("<II", 2**32 - 1, 2**32 - 1),
        whole[:8] + b"\xff" * 400,
    ):
        with pytest.raises(FrameError, match=r"^depth: .*copy the recording again$"):
            decode_rvl(data, "depth")
    for _ in range(300):
        data = bytearray(whole)
        data[random.integers(8, len(data))] = random.integers(256)
        try:
            assert decode_rvl(bytes(data), "depth").shape == (24, 40)
        except FrameError as error:
            assert "\n" not in str(error)


@pytest.mark.parametrize("encoding", ["16UC1", "32FC1"])
def test_a_bag_with_rvl(encoding: str, tmp_path: Path) -> None:
    """1 m, and 2.5 m in the last pixel; as floats stored as a / z + b with a = 1000, b = 1."""
    metres = depth_image(1000) / 1000
    metres[-1, -1] = 2.5
    raw = metres * 1000 if encoding == "16UC1" else np.divide(1000, metres, out=np.zeros_like(metres), where=metres > 0) + (metres > 0)
    data = struct.pack("<iff", 0, 1000, 1) + encode_rvl(np.rint(raw).astype(np.uint16))
    messages = [(INFO, 1.0, camera_info())]
    for i in range(3):
        stamp = 1 + i / 30
        messages.append((COLOUR, stamp, image(colour_image(i), "bgr8", stamp)))
        messages.append((f"{DEPTH}/compressedDepth", stamp, compressed(data, f"{encoding}; compressedDepth rvl", stamp)))
    recording = open_recording(write_bag(tmp_path / "room.bag", messages))
    assert len(recording) == 3 and recording[0].depth.shape == (HEIGHT, WIDTH)
    np.testing.assert_allclose(recording[1].depth, metres, rtol=1e-3)


def test_an_unfinished_bag_is_named(tmp_path: Path) -> None:
    (tmp_path / "room.bag.active").write_bytes(b"#ROSBAG V2.0\n")
    for path in (tmp_path, tmp_path / "room.bag.active"):
        with pytest.raises(RecordingError, match="rosbag did not finish this bag: run `rosbag reindex` on it"):
            open_recording(path)
