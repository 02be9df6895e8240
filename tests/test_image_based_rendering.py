"""Views by the archive's images over the map."""

from pathlib import Path

import numpy as np
import pytest
import torch

from helpers.painted_wall import CAMERA, WALL, at, painted
from idfslam.compute.backend import plain_torch
from idfslam.evaluation.view_error import psnr
from idfslam.geometry.camera import Camera
from idfslam.mapping.saved_map import SavedMap
from idfslam.views.encoded_view import encode
from idfslam.views.image_archive import ImageArchive, archive_of
from idfslam.views.image_based_rendering import MapViews
from idfslam.views.push_pull import push_pull


class NoMap(SavedMap):
    """A map that has learnt nothing, or a grey wall 2 m ahead of every camera, without a network."""

    def __init__(self, grey: float | None = None) -> None:
        object.__setattr__(self, "grey", grey)

    def render(self, T_wc: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
        shape = (camera.height, camera.width)
        if self.grey is None:  # type: ignore[attr-defined]
            return np.zeros((*shape, 3), np.float32), np.zeros(shape, np.float32)
        return np.full((*shape, 3), self.grey, np.float32), np.full(shape, WALL, np.float32)  # type: ignore[attr-defined]


def archive(*places: float, gains: tuple[float, ...] = ()) -> ImageArchive:
    poses = [at(x) for x in places]
    frames = [painted(i, T, gain) for i, (T, gain) in enumerate(zip(poses, gains or (1.0,) * len(poses)))]
    return archive_of([encode(frame, 0.5) for frame in frames], CAMERA, np.stack(poses))


def test_a_new_view_is_what_a_camera_would_see() -> None:
    view = at(0.02, 0.01, 0.03)
    colour, depth = MapViews(NoMap(), archive(-0.1, -0.05, 0.0, 0.05, 0.1)).render(view, CAMERA)
    true = painted(0, view)
    assert psnr(colour, true.colour) > 34
    assert (depth > 0).mean() > 0.95
    assert np.median(np.abs(depth - true.depth)[depth > 0]) < 0.002


def test_plain_torch_gives_the_same_view() -> None:
    views, small = MapViews(NoMap(), archive(-0.1, 0.1)), CAMERA.resized(40, 30)
    compiled = views.render(at(0.0), small)
    with plain_torch():
        plain = views.render(at(0.0), small)
    assert psnr(compiled[0], plain[0]) > 45


def test_one_exposure_for_images_of_two() -> None:
    views = MapViews(NoMap(), archive(*np.linspace(-0.2, 0.2, 9), gains=(1.0, 1.3) * 4 + (1.0,)))
    gains = np.exp(views.archive.exposures[:, :, 0].mean(1))
    np.testing.assert_allclose(gains / gains[0], (1.0, 1.3) * 4 + (1.0,), atol=0.03)
    colour = views.render(at(0.025), CAMERA)[0]
    true = painted(0, at(0.025)).colour
    ratio = colour[20:-20, 20:-20].mean() / true[20:-20, 20:-20].mean()
    assert 1.0 < ratio < 1.3  # between those of the images around
    assert psnr(colour / np.float32(ratio), true) > 30  # and no patchwork


def test_holes_show_the_map_without_a_seam() -> None:
    dark = archive(0.0, gains=(0.7,))
    view = at(0.5)  # its right part is in no image
    colour, depth = MapViews(NoMap(0.45), dark).render(view, CAMERA)
    assert (depth[:, -30:] > 0).all()
    edge = int(np.flatnonzero((colour[60] != 0).all(-1))[-1])
    assert edge == CAMERA.width - 1
    steps = np.abs(np.diff(colour[60, 90:].mean(-1)))
    assert steps.max() < 0.06


def test_nothing_is_shown_where_nothing_is_known() -> None:
    colour, depth = MapViews(NoMap(), archive(0.0)).render(at(0.0, 0.0, 2.0), CAMERA)
    assert not colour.any()
    assert not depth.any()


def test_push_pull_keeps_what_is_known_and_fills_smoothly() -> None:
    image = np.tile(np.linspace(0, 1, 33, dtype=np.float32), (17, 1))
    known = np.ones(image.shape, bool)
    known[:, 12:20] = False
    filled = push_pull(image, known)
    np.testing.assert_array_equal(filled[known], image[known])
    assert np.abs(filled - image).max() < 0.15
    assert not push_pull(image, np.zeros_like(known)).any()


@pytest.mark.slow
def test_the_images_beat_the_map_s_own_colour(known_run: Path, box_recording: Path) -> None:
    from helpers.box_room import box_poses
    from idfslam.datasets import open_recording
    from idfslam.mapping.saved_map import load_map
    from idfslam.runs import result_folder

    torch.manual_seed(0)
    recording, poses = open_recording(box_recording), box_poses()
    kept = [0, 2, 4, 6, 8, 10, 12]
    images = archive_of([encode(recording[i], 0.5) for i in kept], recording.camera, poses[kept])
    saved = load_map(known_run / result_folder.MAP)
    of_map, of_images = (renderer.render(poses[5], recording.camera)[0] for renderer in (saved, MapViews(saved, images)))
    true = recording[5].colour
    assert psnr(of_images, true) > psnr(of_map, true) + 3
