"""Black and white images, which show nothing: found by their pixels, and no evidence for or against a pose."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from helpers.flat_wall import CAMERA, at, wall_frames
from helpers.small_config import small
from idfslam.datasets.generated.room import SyntheticRoom
from idfslam.frame import Frame, Status
from idfslam.graph.keyframe import Keyframe
from idfslam.sensing.clipping import is_clipped
from idfslam.slam import Slam

BLIND = range(14, 18)  # frames whose image is white


def image(brightness: float, noise: float = 0.0) -> np.ndarray:
    grain = noise * np.random.default_rng(0).standard_normal((48, 64, 3))
    return np.clip(brightness + grain, 0, 1).astype(np.float32)


def test_black_and_white_images_are_clipped() -> None:
    assert is_clipped(image(0.0)) and is_clipped(image(0.01, 0.01)) and is_clipped(image(1.0))
    assert not is_clipped(image(0.05, 0.01)) and not is_clipped(image(0.5)) and not is_clipped(image(0.95, 0.01))
    part = np.ones((160, 160, 3), np.float32)
    part[:, :8] = 0.5  # a twentieth
    assert is_clipped(part)
    part[:, :24] = 0.5
    assert not is_clipped(part)


def test_a_recording_of_depth_alone_lacks_nothing() -> None:
    """Its images are all black. A black one among others tells nothing."""
    frames = wall_frames(places=(0.0,))
    depth = np.full((48, 64), 2.0, np.float32)
    black, grey = (
        Keyframe(Frame(9, 0.3, image(b), depth, CAMERA), at(0.1), torch.from_numpy(depth), torch.from_numpy(image(b))) for b in (0.0, 0.5)
    )
    last = frames.graph.last_keyframe
    assert last is not None
    for of_last, lacks in ((0.0, False), (0.5, True)):
        frames.graph.last_keyframe = Keyframe(replace(last.frame, colour=image(of_last)), last.T_wk, last.depth, last.colour)
        assert frames.graph.lacks_colour(black) is lacks
        assert not frames.graph.lacks_colour(grey)


@pytest.mark.slow
def test_depth_goes_on_alone_and_a_lamp_that_goes_out_is_no_doubt() -> None:
    """White images for four frames, and a third of the light from then on: all frames are ok, and poses within 1.8 cm."""
    room = SyntheticRoom(3, 24, 160, 120, noise=True)
    torch.set_num_threads(1)
    slam, results = Slam(small()), []
    for i in range(len(room)):
        f = room[i]
        light = 1.0 if i < BLIND.start else 0.35
        results.append(slam.process(replace(f, colour=np.ones_like(f.colour) if i in BLIND else f.colour * np.float32(light))))
    T_true = np.linalg.inv(room.ground_truth[0]) @ room.ground_truth
    off = np.array([np.linalg.norm(r.T_wc[:3, 3] - T[:3, 3]) for r, T in zip(results, T_true)])
    assert off.max() < 0.02
    assert all(r.status is Status.OK for r in results)
    assert not any(results[i].keyframe for i in BLIND)
