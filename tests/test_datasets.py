"""Every layout, on small recordings written here: what is read, in which units, by which camera."""

import json
import threading
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from helpers.recordings import (
    DEPTH,
    HEIGHT,
    WIDTH,
    colour_image,
    depth_image,
    pose,
    write_folder,
    write_icl_nuim,
    write_replica,
    write_scannet,
    write_sens,
    write_seven_scenes,
    write_tum,
)
from helpers.shared_data import shared_recording
from idfslam.datasets import FORMATS, Prefetch, open_recording
from idfslam.datasets.images.decoding import Undistortion
from idfslam.datasets.recording import Selection, reading_threads
from idfslam.errors import ConfigError, FrameError, RecordingError
from idfslam.frame import Frame
from idfslam.geometry.camera import Camera

OVERRIDE = {"fx": 20.0, "fy": 21.0, "cx": 7.0, "cy": 5.0}
WRITERS = {
    "folder": write_folder,
    "tum": write_tum,
    "replica": write_replica,
    "7scenes": write_seven_scenes,
    "scannet": write_scannet,
    "icl_nuim": write_icl_nuim,
}


def check_frame(frame: Frame, i: int) -> None:
    """Frame i as `recordings` writes it: red (10 + i) / 255, green 0.2 * 255 = 51, blue 102; depth 1 m, 0 in one corner."""
    assert frame.index == i
    assert frame.colour.shape == (HEIGHT, WIDTH, 3) and frame.depth.shape == (HEIGHT, WIDTH)
    assert frame.colour.dtype == np.float32 and frame.depth.dtype == np.float32
    np.testing.assert_allclose(frame.colour[6, 8], [(10 + i) / 255, 51 / 255, 102 / 255], atol=2.5 / 255)  # JPEG errs by 2
    np.testing.assert_allclose(frame.depth[6, 8], DEPTH, atol=1e-4)
    assert frame.depth[0, 0] == 0


@pytest.mark.parametrize("name", WRITERS)
def test_every_layout_is_recognised_and_read(name: str, tmp_path: Path) -> None:
    path = WRITERS[name](tmp_path / "room")
    recording = open_recording(path)
    assert len(recording) == 3
    for i in range(3):
        check_frame(recording[i], i)
    assert recording.camera == Camera(WIDTH, HEIGHT, 15.0, 15.0, 7.5, 5.5)
    assert recording.ground_truth is not None
    np.testing.assert_allclose(recording.ground_truth, [pose(i) for i in range(3)], atol=1e-6)
    np.testing.assert_allclose(np.diff(recording.timestamps), 1 / 30, atol=1e-6)
    assert len(open_recording(path, format=name)) == 3
    assert recording.surface() is None


@pytest.mark.parametrize("name", WRITERS)
def test_the_override_wins_over_everything(name: str, tmp_path: Path) -> None:
    path = WRITERS[name](tmp_path / "room")
    recording = open_recording(path, camera=OVERRIDE, depth_scale=500)
    assert recording.camera == Camera(WIDTH, HEIGHT, 20.0, 21.0, 7.0, 5.0)
    plain = open_recording(path)
    ratio = recording[0].depth[6, 8] / plain[0].depth[6, 8]
    assert ratio == pytest.approx({"tum": 10, "icl_nuim": 10, "replica": 13.107}.get(name, 2), rel=1e-4)  # layout's scale / 500


@pytest.mark.parametrize("name", WRITERS)
def test_a_partial_override_is_filled_from_the_recording(name: str, tmp_path: Path) -> None:
    path = WRITERS[name](tmp_path / "room")
    recording = open_recording(path, camera={"fx": 20.0, "fy": None, "cx": None, "cy": None})
    assert recording.camera == Camera(WIDTH, HEIGHT, 20.0, 15.0, 7.5, 5.5)


def test_cam_params_win_over_other_files_and_publications(tmp_path: Path) -> None:
    path = write_folder(tmp_path / "rgbd_dataset_freiburg1_room")
    camera = {"w": WIDTH, "h": HEIGHT, "fx": 30, "fy": 31, "cx": 6, "cy": 4, "scale": 2000}
    (path / "cam_params.json").write_text(json.dumps({"camera": camera}))
    recording = open_recording(path)
    assert recording.camera == Camera(WIDTH, HEIGHT, 30.0, 31.0, 6.0, 4.0)
    assert recording[0].depth[6, 8] == pytest.approx(0.5)  # 1000 units at 2000 a metre


def test_published_cameras(tmp_path: Path) -> None:
    size = (640, 480)
    seven = write_seven_scenes(tmp_path / "chess", frames=1, size=size, cam_params=False)
    assert open_recording(seven).camera == Camera(640, 480, 585.0, 585.0, 320.0, 240.0)
    icl = write_icl_nuim(tmp_path / "living_room_traj2_frei_png", frames=1, size=size, cam_params=False)
    assert open_recording(icl).camera == Camera(640, 480, 481.2, 480.0, 319.5, 239.5)
    replica = write_replica(tmp_path / "office0", frames=1, size=(1200, 680), cam_params=False)
    assert open_recording(replica).camera == Camera(1200, 680, 600.0, 600.0, 599.5, 339.5)
    freiburg = write_tum(tmp_path / "rgbd_dataset_freiburg3_desk", frames=1, size=size, cam_params=False)
    assert open_recording(freiburg).camera == Camera(640, 480, 535.4, 539.2, 320.1, 247.6)


def test_replica_camera_lies_in_the_parent_as_published(tmp_path: Path) -> None:
    path = write_replica(tmp_path / "room0", cam_params=False)
    camera = {"w": WIDTH, "h": HEIGHT, "fx": 30, "fy": 31, "cx": 6, "cy": 4, "scale": 6553.5}
    (tmp_path / "cam_params.json").write_text(json.dumps({"camera": camera}))
    assert open_recording(path).camera.fx == 30


def test_a_camera_file_may_be_one_line(tmp_path: Path) -> None:
    path = write_folder(tmp_path / "room")
    (path / "intrinsics.txt").unlink()
    (path / "calibration.txt").write_text("# fx fy cx cy\n15.5 16 7 5\n")
    assert open_recording(path).camera == Camera(WIDTH, HEIGHT, 15.5, 16.0, 7.0, 5.0)


def test_depth_65535_is_no_reading(tmp_path: Path) -> None:
    path = write_seven_scenes(tmp_path / "chess")
    raw = depth_image(1000)
    raw[3, 4] = 65535
    cv2.imwrite(str(path / "frame-000001.depth.png"), raw)
    assert open_recording(path)[1].depth[3, 4] == 0


def test_colour_png_with_alpha_and_grey_are_read(tmp_path: Path) -> None:
    path = write_folder(tmp_path / "room", suffix="png")
    image = colour_image(0)
    cv2.imwrite(str(path / "rgb/000000.png"), np.dstack([image, np.full(image.shape[:2], 255, np.uint8)]))
    cv2.imwrite(str(path / "rgb/000001.png"), np.full((HEIGHT, WIDTH), 51, np.uint8))
    recording = open_recording(path)
    np.testing.assert_allclose(recording[0].colour[6, 8], [10 / 255, 51 / 255, 102 / 255], atol=1e-6)
    np.testing.assert_allclose(recording[1].colour[6, 8], 0.2, atol=1e-6)


def test_folder_accepts_color_and_traj(tmp_path: Path) -> None:
    path = write_folder(tmp_path / "room")
    (path / "rgb").rename(path / "color")
    for file in (path / "pose").iterdir():
        file.unlink()
    (path / "pose").rmdir()
    assert open_recording(path).ground_truth is None
    np.savetxt(path / "traj.txt", np.stack([pose(i).ravel() for i in range(3)]))
    truth = open_recording(path).ground_truth
    assert truth is not None
    np.testing.assert_allclose(truth[2], pose(2), atol=1e-6)


def test_frames_without_a_pose_are_nan(tmp_path: Path) -> None:
    path = write_scannet(tmp_path / "scene0000_00")
    np.savetxt(path / "pose/1.txt", np.full((4, 4), -np.inf))
    truth = open_recording(path).ground_truth
    assert truth is not None
    assert np.isfinite(truth[[0, 2]]).all() and np.isnan(truth[1]).all()


# ----- TUM


def test_tum_uses_colour_stamps_and_every_colour_image_is_a_frame(tmp_path: Path) -> None:
    path = write_tum(tmp_path / "room")
    lines = (path / "depth.txt").read_text().splitlines()
    # header, 1: 100.000 s; 2: 100.033 s moved by 15 ms (kept); 3: 100.067 s moved by 25 ms (the nearest in time)
    lines[2] = lines[2].replace("100.033333 ", "100.048333 ")
    lines[3] = lines[3].replace("100.066667 ", "100.091667 ")
    (path / "depth.txt").write_text("\n".join(lines))
    recording = open_recording(path)
    np.testing.assert_allclose(recording.timestamps, [100.0, 100.033333, 100.066667])
    assert [recording[i].depth_timestamp for i in range(3)] == [100.0, 100.048333, 100.048333]  # 18 ms before, 25 ms after


def test_tum_ground_truth_is_nearest_in_time(tmp_path: Path) -> None:
    path = write_tum(tmp_path / "room")
    rows = ["# timestamp tx ty tz qx qy qz qw"]
    rows += ["99.985 1 0 0 0 0 0 1", "100.010 2 0 0 0 0 0 1", "100.040 3 0 0 0 0 0.70710678 0.70710678"]
    (path / "groundtruth.txt").write_text("\n".join(rows))
    truth = open_recording(path).ground_truth
    assert truth is not None
    assert truth[0, 0, 3] == 2 and truth[1, 0, 3] == 3  # 10 ms before 15 ms; 7 ms
    assert np.isnan(truth[2]).all()  # 100.0667: 27 ms away
    np.testing.assert_allclose(truth[1, :3, :3], [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-7)  # 90 degrees about z


def test_distortion_is_undone() -> None:
    """A point that the distorted lens shows at pixel (u, v) appears at the pinhole's own pixel."""
    camera, k = Camera(640, 480, 517.3, 516.5, 318.6, 255.3), (0.2624, -0.9531, -0.0054, 0.0026, 1.1633)
    x, y = 0.4, -0.3  # r2 = 0.25; OpenCV's radial-tangential model by hand:
    r2 = x * x + y * y
    radial = 1 + k[0] * r2 + k[1] * r2**2 + k[4] * r2**3
    u = camera.fx * (x * radial + 2 * k[2] * x * y + k[3] * (r2 + 2 * x * x)) + camera.cx
    v = camera.fy * (y * radial + k[2] * (r2 + 2 * y * y) + 2 * k[3] * x * y) + camera.cy
    bgr, raw = np.zeros((480, 640, 3), np.uint8), np.full((480, 640), 1000, np.uint16)
    patch = np.s_[round(v) - 2 : round(v) + 3, round(u) - 2 : round(u) + 3]
    bgr[patch], raw[patch] = 255, 2000
    undistort = Undistortion(camera, k)
    colour, depth = undistort.colour(bgr), undistort.depth(raw)
    at = round(camera.fy * y + camera.cy), round(camera.fx * x + camera.cx)
    assert np.hypot(at[0] - v, at[1] - u) > 3  # the lens moves it by more than the patch is wide
    assert (colour[at] == 255).all() and depth[at] == 2000
    assert set(np.unique(depth)) <= {0, 1000, 2000}  # nearest: no depth between two surfaces


def test_freiburg1_is_undistorted_unless_the_camera_is_given_whole(tmp_path: Path) -> None:
    path = write_tum(tmp_path / "rgbd_dataset_freiburg1_desk", frames=1, size=(640, 480), cam_params=False)
    corner = np.s_[2, 636]  # the published lens shows nothing there: no depth after undistortion, or another pixel's
    published = open_recording(path)
    assert published.camera == Camera(640, 480, 517.3, 516.5, 318.6, 255.3)
    given_whole = open_recording(path, camera={"fx": 520.0, "fy": 520.0, "cx": 320.0, "cy": 240.0})
    assert given_whole[0].depth[corner] == pytest.approx(DEPTH)
    assert not np.array_equal(published[0].colour, given_whole[0].colour)
    partial = open_recording(path, camera={"fx": 517.3})
    np.testing.assert_array_equal(partial[0].colour, published[0].colour)


# ----- ICL-NUIM


def test_icl_nuim_axes_are_turned_to_opencv(tmp_path: Path) -> None:
    """y up (fy = -480) to y down: moving up by 1 m becomes y = -1; a turn about x or z changes its sign, about y keeps it."""
    path = write_icl_nuim(tmp_path / "living_room_traj0")
    half = np.sqrt(0.5)
    rows = [f"0 1 2 3 {half} 0 0 {half}", f"1 0 1 0 0 {half} 0 {half}"]
    (path / "room.gt.freiburg").write_text("\n".join(rows))
    truth = open_recording(path).ground_truth
    assert truth is not None
    np.testing.assert_allclose(truth[0], [[1, 0, 0, 1], [0, 0, 1, -2], [0, -1, 0, 3], [0, 0, 0, 1]], atol=1e-7)
    np.testing.assert_allclose(truth[1], [[0, 0, 1, 0], [0, 1, 0, -1], [-1, 0, 0, 0], [0, 0, 0, 1]], atol=1e-7)
    assert np.isnan(truth[2]).all()


def test_icl_nuim_by_name_but_not_where_cam_params_tell_otherwise(tmp_path: Path) -> None:
    named = write_icl_nuim(tmp_path / "office_traj1", cam_params=False, size=(640, 480))
    (named / "room.gt.freiburg").unlink()
    assert open_recording(named).ground_truth is None
    rendered = write_tum(tmp_path / "living_room_traj3")
    truth = open_recording(rendered).ground_truth
    assert truth is not None
    np.testing.assert_allclose(truth[2], pose(2), atol=1e-6)  # not mirrored


# ----- 7-Scenes and ScanNet


def test_seven_scenes_scene_with_one_sequence_opens_and_with_several_asks(tmp_path: Path) -> None:
    write_seven_scenes(tmp_path / "chess/seq-01")
    assert open_recording(tmp_path / "chess").name == "chess-seq-01"
    write_seven_scenes(tmp_path / "chess/seq-02")
    with pytest.raises(RecordingError, match=r"2 sequences \(seq-01, seq-02\), expected one: name .*seq-01"):
        open_recording(tmp_path / "chess")


def test_scannet_colour_comes_to_the_size_of_depth(tmp_path: Path) -> None:
    """Colour of twice the size and the same view: K_colour = 2 K_depth (+ 0.5 for the pixel centres)."""
    path = write_scannet(tmp_path / "scene0000_00", cam_params=False)
    for i in range(3):
        cv2.imwrite(str(path / f"color/{i}.jpg"), cv2.resize(colour_image(i), (2 * WIDTH, 2 * HEIGHT), interpolation=cv2.INTER_NEAREST))
    np.savetxt(path / "intrinsic/intrinsic_color.txt", [[30, 0, 15.5, 0], [0, 30, 11.5, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    recording = open_recording(path)
    assert recording.camera == Camera(WIDTH, HEIGHT, 15.0, 15.0, 7.5, 5.5)
    check_frame(recording[1], 1)


def test_scannet_colour_of_another_focal_length_is_warped_onto_depth(tmp_path: Path) -> None:
    """f_colour = 2 f_depth at one size: the depth pixel 2 right of the centre sees what the colour pixel 4 right of it sees."""
    path = write_scannet(tmp_path / "scene0000_00", cam_params=False)
    image = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    image[:, 12] = 255
    for i in range(3):
        cv2.imwrite(str(path / f"color/{i}.jpg"), image, [cv2.IMWRITE_JPEG_QUALITY, 100])
    np.savetxt(path / "intrinsic/intrinsic_color.txt", [[30, 0, 8, 0], [0, 30, 6, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    np.savetxt(path / "intrinsic/intrinsic_depth.txt", [[15, 0, 8, 0], [0, 15, 6, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    colour = open_recording(path)[0].colour
    assert colour[6, 10, 1] > 0.9 and colour[6, 12, 1] < 0.1


@pytest.mark.parametrize("codecs", [("jpeg", "zlib"), ("png", "raw"), ("raw", "zlib")])
def test_sens_file(codecs: tuple[str, str], tmp_path: Path) -> None:
    path = write_sens(tmp_path / "scene0000_00.sens", colour_codec=codecs[0], depth_codec=codecs[1])
    recording = open_recording(path)
    assert recording.name == "scene0000_00" and len(recording) == 3
    assert recording.camera == Camera(WIDTH, HEIGHT, 15.0, 15.0, 7.5, 5.5)
    for i in (2, 0, 1):  # in any order
        check_frame(recording[i], i)
    assert recording.ground_truth is not None
    np.testing.assert_allclose(recording.ground_truth[2], pose(2), atol=1e-6)
    np.testing.assert_allclose(recording.timestamps, [1.0, 1.033333, 1.066666])
    assert len(open_recording(tmp_path)) == 3  # the folder that holds it


def test_sens_file_without_stamps_or_poses(tmp_path: Path) -> None:
    path = write_sens(tmp_path / "scene.sens", stamps=False, poses=False)
    recording = open_recording(path)
    assert recording.ground_truth is None
    np.testing.assert_allclose(recording.timestamps, [0, 1 / 30, 2 / 30])


def test_sens_frame_that_cannot_be_unpacked_is_one_bad_frame(tmp_path: Path) -> None:
    path = write_sens(tmp_path / "scene.sens")
    data = bytearray(path.read_bytes())
    last = zlib.compress(depth_image(1000).tobytes())
    at = data.rindex(last)
    data[at + 2 : at + 10] = b"\xff" * 8
    path.write_bytes(data)
    recording = open_recording(path)
    check_frame(recording[1], 1)
    with pytest.raises(FrameError, match="frame 2: depth cannot be unpacked"):
        recording[2]


# ----- selection, reading ahead, synthetic rooms


def test_selection_numbers_from_zero_and_keeps_stamps_and_poses(tmp_path: Path) -> None:
    path = write_folder(tmp_path / "room", frames=10)
    chosen = open_recording(path, start=2, stride=3, frames=2)  # frames 2 and 5 of 2, 5, 8
    assert len(chosen) == 2 and [chosen[i].index for i in range(2)] == [0, 1]
    np.testing.assert_allclose(chosen.timestamps, [2 / 30, 5 / 30])
    assert chosen[1].timestamp == pytest.approx(5 / 30)
    assert chosen[1].colour[6, 8, 0] == pytest.approx(15 / 255, abs=2.5 / 255)
    assert chosen.ground_truth is not None
    np.testing.assert_allclose(chosen.ground_truth[1], pose(5), atol=1e-6)
    assert len(open_recording(path, start=2, stride=3)) == 3
    assert sum(1 for _ in chosen) == 2  # indexing past the end stops a plain loop


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"start": 10}, "start 10 lies outside the 10 frames of room: choose 0 to 9"),
        ({"start": -1}, "start -1 lies outside"),
        ({"stride": 0}, "stride 0, expected at least 1"),
        ({"frames": 0}, "frames 0 .* choose 1 to 10"),
        ({"frames": -6, "stride": 2}, "frames -6 from start 0 with stride 2: room has 10 frames, choose 1 to 5"),
        ({"format": "kitti"}, "format 'kitti', expected one of"),
        ({"camera": {"focal": 5.0}}, "unknown value 'focal'"),
    ],
)
def test_arguments_out_of_range(arguments: dict, message: str, tmp_path: Path) -> None:
    path = write_folder(tmp_path / "room", frames=10)
    with pytest.raises(ConfigError, match=message):
        open_recording(path, **arguments)


def test_more_frames_than_there_are_means_all(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = write_folder(tmp_path / "room", frames=10)
    assert len(open_recording(path, frames=300, start=4, stride=2)) == 3
    assert [record.message for record in caplog.records if "asked for" in record.message] == ["room: 300 frames asked for, all 3 are taken"]
    caplog.clear()
    assert len(open_recording(path, frames=10)) == len(open_recording(path, frames=300, report=False)) == 10
    assert "asked for" not in caplog.text


def prefetch_threads() -> list[threading.Thread]:
    return [thread for thread in threading.enumerate() if thread.name.startswith("prefetch")]


def test_prefetch_yields_every_frame_in_order_and_bad_ones_as_errors(tmp_path: Path) -> None:
    path = write_folder(tmp_path / "room", frames=7)
    (path / "depth/000003.png").unlink()
    (path / "depth/000003.png").write_bytes(b"no image")
    seen = list(Prefetch(open_recording(path), depth=2))
    assert [i for i, _ in seen] == list(range(7))
    assert isinstance(seen[3][1], FrameError)
    for i in (0, 1, 2, 4, 5, 6):
        frame = seen[i][1]
        assert isinstance(frame, Frame)
        check_frame(frame, i)
    assert not prefetch_threads()


class Slow:
    """A dataset whose frames wait for each other: frame 2k is there only once 2k + 1 has been asked for."""

    reading_threads = 2

    def __init__(self, dataset: Selection) -> None:
        self.dataset, self.asked = dataset, [threading.Event() for _ in range(len(dataset))]

    def __len__(self) -> int:
        return len(self.dataset)

    def __getitem__(self, i: int) -> Frame:
        self.asked[i].set()
        assert self.asked[i | 1].wait(20)
        return self.dataset[i]


def test_a_slow_dataset_is_read_by_several_threads_in_order(tmp_path: Path) -> None:
    slow = Slow(open_recording(write_folder(tmp_path / "room", frames=6)))
    assert [frame.index for _, frame in Prefetch(slow) if isinstance(frame, Frame)] == list(range(6))
    assert not prefetch_threads()


def test_a_selection_has_as_many_readers_as_what_it_selects_from(tmp_path: Path) -> None:
    recording = open_recording(write_folder(tmp_path / "room", frames=4))
    assert reading_threads(recording) == 1
    recording.reading_threads = 2
    assert reading_threads(Selection(recording, stride=2)) == 2


class Counting:
    """A dataset that remembers what was asked of it."""

    def __init__(self, dataset: Selection) -> None:
        self.dataset, self.asked = dataset, list[int]()

    def __len__(self) -> int:
        return len(self.dataset)

    def __getitem__(self, i: int) -> Frame:
        self.asked.append(i)
        if i == 5:
            raise RuntimeError("a fault of the program")
        return self.dataset[i]


def test_prefetch_reads_ahead_no_further_than_told_and_ends_with_the_loop(tmp_path: Path) -> None:
    counting = Counting(open_recording(write_folder(tmp_path / "room", frames=5)))
    for i, _ in Prefetch(counting, depth=2):
        assert len(counting.asked) <= i + 3  # this one and two ahead
        if i == 1:
            break
    assert not prefetch_threads()


@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError])
def test_prefetch_ends_with_an_error_of_the_caller(error: type[BaseException], tmp_path: Path) -> None:
    recording = open_recording(write_folder(tmp_path / "room"))
    with pytest.raises(error):
        for _ in Prefetch(recording):
            raise error
    assert not prefetch_threads()


def test_prefetch_passes_on_other_errors(tmp_path: Path) -> None:
    counting = Counting(open_recording(write_folder(tmp_path / "room", frames=8)))
    with pytest.raises(RuntimeError, match="a fault of the program"):
        list(Prefetch(counting))
    assert not prefetch_threads()


def test_synthetic_rooms_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    """A stand-in remembers how the room would be built: building one takes seconds."""
    built: list[dict] = []

    class Room:
        name, camera, ground_truth = "room", Camera(WIDTH, HEIGHT, 15.0, 15.0, 7.5, 5.5), None

        def __init__(self, **arguments: int) -> None:
            built.append(arguments)
            self.timestamps = np.arange(arguments["frames"]) / 30

        def __len__(self) -> int:
            return len(self.timestamps)

        def surface(self) -> str:
            return "the surface"

    monkeypatch.setattr("idfslam.datasets.generated.room.SyntheticRoom", Room)
    chosen = open_recording("synthetic:3:kinect", start=10, frames=2, stride=5)
    np.testing.assert_allclose(chosen.timestamps, [10 / 30, 15 / 30])
    assert chosen.surface() == "the surface"
    assert len(open_recording("synthetic")) == 600
    assert len(open_recording("synthetic:1", start=100, frames=700)) == 700  # goes round again
    assert built == [
        {"seed": 3, "frames": 600, "noise": True, "movers": None},
        {"seed": 0, "frames": 600, "noise": False, "movers": None},
        {"seed": 1, "frames": 800, "noise": False, "movers": None},
    ]
    assert "synthetic" in FORMATS
    with pytest.raises(ConfigError, match="own camera"):
        open_recording("synthetic", camera={"fx": 500.0})
    with pytest.raises(RecordingError, match="not a synthetic room"):
        open_recording("synthetic:fine", format="synthetic")


def test_an_existing_folder_called_synthetic_is_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_folder(tmp_path / "synthetic")
    monkeypatch.chdir(tmp_path)
    assert open_recording("synthetic").name == "synthetic"


def test_shared_recording_opens_as_documented() -> None:
    recording = open_recording(shared_recording("redkitchen"))
    assert len(recording) == 1000 and recording.camera == Camera(640, 480, 527.21, 527.21, 322.25, 238.73)
    assert recording.ground_truth is not None and np.isfinite(recording.ground_truth).all()
    path_length = np.linalg.norm(np.diff(recording.ground_truth[:, :3, 3], axis=0), axis=1).sum()
    assert path_length == pytest.approx(7.4, abs=0.1)  # [m], as documented with the data
    present = np.mean([(recording[i].depth > 0).mean() for i in range(0, 1000, 100)])
    assert present == pytest.approx(0.72, abs=0.05)  # the share of pixels with depth, its border included
