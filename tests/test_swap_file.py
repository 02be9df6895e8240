"""Images and features swapped out and read again."""

import errno
import os
import resource
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from idfslam.frame import Frame
from idfslam.geometry.camera import Camera
from idfslam.geometry.sensor_timing import SYNCHRONISED, SensorTiming
from idfslam.graph.keyframe import Keyframe
from idfslam.graph.swap_file import SwapFile
from idfslam.sensing.rectification import Rectification, RowTimes
from idfslam.tracking.frame_features import FrameFeatures

CAMERA = Camera(64, 48, 40.0, 40.0, 31.5, 23.5)


@pytest.fixture(autouse=True)
def no_room_is_kept_free(monkeypatch: pytest.MonkeyPatch) -> None:
    """The disk that the tests run on may be nearly full."""
    monkeypatch.setattr("idfslam.graph.swap_file.LEFT_FREE", 0)


def keyframe(index: int, *, eight_bits: bool) -> Keyframe:
    random = np.random.default_rng(index)
    colour = random.integers(0, 256, (48, 64, 3)) * np.float32(1 / 255) if eight_bits else random.random((48, 64, 3))
    depth = np.where(random.random((48, 64)) < 0.2, 0, random.uniform(0.4, 5, (48, 64))).astype(np.float32)
    frame = Frame(index, index / 30, colour.astype(np.float32), depth, CAMERA, index / 30 + 0.004, SensorTiming(0.026, 0.0, None))
    made = Keyframe(frame, torch.eye(4, dtype=torch.float64), torch.from_numpy(depth), torch.from_numpy(frame.colour))
    made.host = index
    return made


def features(index: int) -> FrameFeatures:
    """As the tracker makes it: channels last, the trunk in bf16."""
    generator = torch.Generator().manual_seed(index)
    trunk, colour, points = (torch.randn(12, 16, channels, generator=generator) for channels in (64, 3, 3))
    return FrameFeatures(trunk.bfloat16().permute(2, 0, 1), colour.permute(2, 0, 1), points, CAMERA.resized(16, 12), CAMERA)


@pytest.mark.parametrize("eight_bits", [True, False])
def test_images_come_back_exactly(eight_bits: bool) -> None:
    swap, keyframes = SwapFile(2), [keyframe(i, eight_bits=eight_bits) for i in range(5)]
    before = [(k.frame, k.depth.clone(), k.colour.clone()) for k in keyframes]
    for k in keyframes:
        k.keep_in(swap, k.host)
    assert [k._images is None for k in keyframes] == [True, True, True, False, False]
    for k, (frame, depth, colour) in zip(keyframes, before):
        assert torch.equal(k.depth, depth)
        assert torch.equal(k.colour, colour)
        assert (k.frame.index, k.frame.timestamp, k.frame.camera) == (frame.index, frame.timestamp, CAMERA)
        assert (k.frame.depth_timestamp, k.frame.timing) == (frame.depth_timestamp, frame.timing)
        assert sum(other._images is not None for other in keyframes) == 2


def test_a_stored_keyframe_that_is_rectified_comes_back_rectified() -> None:
    swap, keyframes = SwapFile(1), [keyframe(i, eight_bits=True) for i in range(2)]
    for k in keyframes:
        k.keep_in(swap, k.host)
    first, raw = keyframes[0], keyframes[0].colour.clone()  # in the file by now, and read again
    first.keep_features(features(0))
    first.rectify(Rectification(RowTimes(0.03), np.array([0.0, 0, 0, 0, 0, 3.0])))
    shown = first.colour.clone()
    assert first.features is None
    assert not torch.equal(shown, raw)
    assert first.taken is first.images  # the images as they were taken are no longer kept
    assert keyframes[1].depth.shape == (48, 64)  # puts the first one away
    assert first._images is None
    assert torch.equal(first.colour, shown)
    assert (first.frame.timing, first.frame.depth_lag) == (SYNCHRONISED, 0.0)


def test_images_are_rectified_when_they_are_asked_for() -> None:
    made = keyframe(0, eight_bits=True)
    taken = made.images
    made.rectify(Rectification(RowTimes(0.03), np.array([0.0, 0, 0, 0, 0, 3.0])))
    assert made._images is None and made.taken is taken
    assert made.has_depth and made._images is None  # what only needs the raw images does not rectify
    first = made.colour.clone()
    made.rectify(Rectification(RowTimes(0.03), np.array([0.0, 0, 0, 0, 0, -3.0])))  # from the raw images again
    assert made.taken is taken
    assert not torch.equal(made.colour, first)


def slope() -> Keyframe:
    """A wall that is 1 m away at the left edge and 2 m at the right one, without noise."""
    depth = np.tile(np.linspace(1.0, 2.0, 64, dtype=np.float32), (48, 1))
    frame = replace(keyframe(0, eight_bits=True).frame, depth=depth)
    return Keyframe(frame, torch.eye(4, dtype=torch.float64), torch.from_numpy(depth), torch.from_numpy(frame.colour))


def test_stored_images_are_carried_on_when_the_times_are_known_better() -> None:
    """At 3 rad/s depth of 20 ms before lies 2.4 px beside colour. After 8 and then 20 ms it is that of 20 at once, to two millimetres."""
    velocity, latest = np.array([0.0, 0, 0, 0, 3.0, 0]), RowTimes(0.0, 0.0, -0.02)
    stored, at_once = slope(), slope()
    stored.rectify(Rectification(RowTimes(0.0, 0.0, -0.008), velocity))
    stored.keep_in(SwapFile(2), 0)
    early = stored.depth.clone()
    stored.rectify_further(latest)
    at_once.rectify(Rectification(latest, velocity))
    further, once, before = (depth[4:-4, 8:-8] for depth in (stored.depth, at_once.depth, early))  # at the border there are no readings
    assert bool((further > 0).all() and (once > 0).all())
    assert float((further - once).abs().max()) < 2e-3
    assert float((before - once).abs().mean()) > 0.02
    assert stored.rectification is not None and stored.rectification.times == latest
    assert stored.earlier_times == (RowTimes(0.0, 0.0, -0.008),)
    again = slope()
    again.rectify_again(stored.state())
    assert torch.equal(again.depth, stored.depth) and torch.equal(again.colour, stored.colour)
    assert again.earlier_times == stored.earlier_times


@pytest.mark.parametrize(("rows", "columns", "enough"), [(48, 64, True), (10, 13, True), (10, 6, False), (1, 5, False)])
def test_a_few_readings_begin_no_map(rows: int, columns: int, enough: bool) -> None:
    """The image has 48 rows and 64 columns: a fifth of both is enough, five readings are not."""
    made = keyframe(0, eight_bits=True)
    depth = np.zeros((48, 64), np.float32)
    depth[:rows, :columns] = 1.0
    frame = replace(made.frame, depth=depth)
    assert Keyframe(frame, made.T_wk, torch.from_numpy(depth), made.colour).has_depth is enough


def test_what_was_used_last_stays() -> None:
    swap, keyframes = SwapFile(2), [keyframe(i, eight_bits=True) for i in range(3)]
    for k in keyframes[:2]:
        k.keep_in(swap, k.host)
    assert keyframes[0].depth.shape == (48, 64)  # used again
    keyframes[2].keep_in(swap, keyframes[2].host)
    assert [k._images is None for k in keyframes] == [False, True, False]


def test_features_come_back_exactly_and_without_the_images() -> None:
    swap, keyframes = SwapFile(1), [keyframe(i, eight_bits=True) for i in range(3)]
    assert keyframes[0].features is None
    for k in keyframes:
        k.keep_features(features(k.index))
        k.keep_in(swap, k.host)
    for k in (keyframes[0], keyframes[2], keyframes[0]):
        before = features(k.index)
        assert (k._images, k._features) == (None, None)
        assert (k.features.camera, k.features.source) == (before.camera, before.source)
        for name in ("trunk", "colour", "points"):
            again, once = getattr(k.features, name), getattr(before, name)
            assert torch.equal(again, once)
            assert (again.dtype, again.stride()) == (once.dtype, once.stride())
        assert k._images is None
    assert swap._end == 3 * (48 * 64 * 7 + 12 * 16 * (64 * 2 + 6 * 4))  # written once each, though swapped out twice


def test_features_can_be_kept_after_the_images_were_swapped_out() -> None:
    swap, keyframes = SwapFile(1), [keyframe(i, eight_bits=True) for i in range(2)]
    for k in keyframes:
        k.keep_in(swap, k.host)
    keyframes[0].keep_features(features(0))
    assert keyframes[1].depth.shape == (48, 64)  # and the first is put away
    assert keyframes[0].depth.shape == (48, 64)
    assert keyframes[1].features is None
    assert torch.equal(keyframes[0].features.trunk, features(0).trunk)


def test_the_file_lies_in_the_folder_that_is_set_and_is_not_seen(tmp_path: Path) -> None:
    swap, keyframes = SwapFile(1), [keyframe(i, eight_bits=True) for i in range(3)]
    swap.folder = tmp_path
    for k in keyframes:
        k.keep_in(swap, k.host)
    assert swap._file is not None
    assert os.fstat(swap._file.fileno()).st_dev == tmp_path.stat().st_dev
    assert list(tmp_path.iterdir()) == []  # deleted with the process, however that ends


def stay_in_memory(swap: SwapFile, count: int = 4) -> list[Keyframe]:
    """Keyframes handed to a swap file without room: all images and features stay, and stay exact."""
    keyframes = [keyframe(i, eight_bits=True) for i in range(count)]
    for k in keyframes:
        k.keep_features(features(k.index))
        k.keep_in(swap, k.host)
    for k in keyframes:
        assert torch.equal(k.depth, keyframe(k.index, eight_bits=True).depth)
        assert torch.equal(k.features.trunk, features(k.index).trunk)
    return keyframes


def test_a_folder_that_is_gone_leaves_images_in_memory(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    swap = SwapFile(1)
    swap.folder = tmp_path / "gone"
    stay_in_memory(swap)
    assert caplog.messages == [f"{swap.folder}: No such file or directory; the images of further keyframes stay in memory"]


def test_no_folder_for_temporary_files(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    def none() -> str:
        raise FileNotFoundError(errno.ENOENT, "No usable temporary directory found in ['/nonexistent']")

    monkeypatch.setattr("tempfile.gettempdir", none)
    stay_in_memory(SwapFile(1))
    assert len(caplog.messages) == 1
    assert "the folder of temporary files: No usable temporary directory" in caplog.text


def test_room_is_left_on_the_disk(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    monkeypatch.setattr("idfslam.graph.swap_file.LEFT_FREE", 1 << 62)
    swap = SwapFile(1)
    stay_in_memory(swap)
    assert swap._file is None
    assert "would be left on the disk; the images of further keyframes stay in memory" in caplog.text


def test_a_disk_that_becomes_full_keeps_what_is_there(caplog: pytest.LogCaptureFixture) -> None:
    """A file that cannot grow stands for the disk: the third keyframe is written half."""
    swap, limits = SwapFile(1), resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (115_000, limits[1]))
        keyframes = stay_in_memory(swap)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert swap.full
    assert [k._images_at is not None for k in keyframes] == [True, True, False, False]
    assert len(caplog.messages) == 1
    assert "File too large; the images of further keyframes stay in memory" in caplog.text
