"""Images put away and had again."""

import numpy as np
import pytest
import torch

from idfslam.frame import Frame
from idfslam.geometry.camera import Camera
from idfslam.graph.archive import Archive
from idfslam.graph.keyframe import Keyframe

CAMERA = Camera(64, 48, 40.0, 40.0, 31.5, 23.5)


def keyframe(index: int, *, eight_bits: bool) -> Keyframe:
    random = np.random.default_rng(index)
    colour = random.integers(0, 256, (48, 64, 3)) * np.float32(1 / 255) if eight_bits else random.random((48, 64, 3))
    depth = np.where(random.random((48, 64)) < 0.2, 0, random.uniform(0.4, 5, (48, 64))).astype(np.float32)
    frame = Frame(index, index / 30, colour.astype(np.float32), depth, CAMERA)
    made = Keyframe(frame, torch.eye(4, dtype=torch.float64), torch.from_numpy(depth), torch.from_numpy(frame.colour))
    made.anchor = index
    return made


@pytest.mark.parametrize("eight_bits", [True, False])
def test_images_come_back_exactly(eight_bits: bool) -> None:
    archive, keyframes = Archive(2), [keyframe(i, eight_bits=eight_bits) for i in range(5)]
    before = [(k.frame, k.depth.clone(), k.colour.clone()) for k in keyframes]
    for k in keyframes:
        k.described = "features"
        k.keep_in(archive)
    assert [k._images is None for k in keyframes] == [True, True, True, False, False]
    assert [k.described for k in keyframes] == [None, None, None, "features", "features"]
    for k, (frame, depth, colour) in zip(keyframes, before):
        assert torch.equal(k.depth, depth)
        assert torch.equal(k.colour, colour)
        assert (k.frame.index, k.frame.timestamp, k.frame.camera) == (frame.index, frame.timestamp, CAMERA)
        assert sum(other._images is not None for other in keyframes) == 2


def test_what_was_used_last_stays() -> None:
    archive, keyframes = Archive(2), [keyframe(i, eight_bits=True) for i in range(3)]
    for k in keyframes[:2]:
        k.keep_in(archive)
    assert keyframes[0].depth.shape == (48, 64)  # used again
    keyframes[2].keep_in(archive)
    assert [k._images is None for k in keyframes] == [False, True, False]
