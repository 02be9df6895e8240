"""Other systems: what they are given and what is read from them, with small programs that stand in for theirs."""

import io
import json
import os
import shutil
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from helpers.box_room import BOX_FRAMES, box_poses
from helpers.fake_peers import write_orbslam3, write_rtabmap
from idfslam.benchmark.peer_runs import PeerRuns
from idfslam.benchmark.peers import measure as measuring
from idfslam.benchmark.peers.choice import PEERS, chosen, find_peer
from idfslam.benchmark.peers.orb_vocabulary import recorded_descriptors, write_vocabulary
from idfslam.benchmark.peers.peer import PeerError
from idfslam.benchmark.peers.programs.frame_stream import (
    StreamFrame,
    StreamHeader,
    read_frames,
    read_header,
    write_frame,
    write_header,
)
from idfslam.benchmark.peers.programs.result_file import ProgramResult, read_result, write_result
from idfslam.benchmark.peers.rtabmap import resampled
from idfslam.datasets import open_recording
from idfslam.datasets.generated.room import SyntheticRoom
from idfslam.errors import ConfigError
from idfslam.geometry.camera import Camera


def test_frames_through_a_pipe() -> None:
    pipe, header = io.BytesIO(), StreamHeader(4, 3, 5.0, 6.0, 1.5, 1.0, 2)
    colour, depth = np.arange(36, dtype=np.uint8).reshape(3, 4, 3), np.arange(12, dtype=np.float32).reshape(3, 4)
    write_header(pipe, header)
    write_frame(pipe, StreamFrame(0.5, colour, depth))
    write_frame(pipe, StreamFrame(0.75, colour[::-1], depth[:, ::-1], np.eye(4)))
    pipe.seek(0)
    assert read_header(pipe) == header
    first, second = read_frames(pipe, header)
    assert (first.timestamp, second.timestamp, first.T_wc) == (0.5, 0.75, None)
    np.testing.assert_array_equal(first.colour, colour)
    np.testing.assert_array_equal(second.colour, colour[::-1])
    np.testing.assert_array_equal(second.depth, depth[:, ::-1])
    np.testing.assert_array_equal(second.T_wc, np.eye(4))
    pipe.truncate(len(pipe.getvalue()) - 1)
    pipe.seek(0)
    with pytest.raises(EOFError):
        list(read_frames(pipe, read_header(pipe)))


def test_results_of_a_program(tmp_path: Path) -> None:
    poses = np.stack([np.eye(4), np.full((4, 4), np.nan)])
    write_result(tmp_path / "r.npz", ProgramResult(poses, 2.5, "1.2", 300.0, np.zeros((3, 3)), np.array([[0, 1, 2]])))
    found = read_result(tmp_path / "r.npz")
    assert (found.seconds, found.version, found.peak_memory_mb, found.faces.tolist()) == (2.5, "1.2", 300.0, [[0, 1, 2]])
    np.testing.assert_array_equal(found.poses, poses)


def test_vocabulary_is_a_tree_that_orbslam3_can_read(tmp_path: Path) -> None:
    generator = np.random.default_rng(0)
    images = [generator.integers(0, 256, (200, 32), np.uint8) for _ in range(5)]
    words = write_vocabulary(tmp_path / "v.txt", images, seed=0)
    head, *lines = (tmp_path / "v.txt").read_text().split("\n")
    assert head == "10 6 0 0"
    rows = np.array([[float(word) for word in line.split()] for line in lines])
    assert rows.shape[1] == 35
    parents, leaves = rows[:, 0].astype(int), rows[:, 1] == 1
    assert (parents < np.arange(1, len(rows) + 1)).all()  # parents come first; the root is 0
    assert leaves.sum() == words
    assert set(np.flatnonzero(~leaves) + 1) == set(parents) - {0}
    level = np.zeros(len(rows) + 1, int)
    for i, parent in enumerate(parents, 1):
        level[i] = level[parent] + 1
    assert level[1:][leaves].min() >= 2  # each word has an ancestor on the second level
    assert (rows[:, 34][~leaves] == 0).all()
    assert rows[:, 34].max() == pytest.approx(np.log(5), abs=1e-6)  # a word of one image of five
    assert np.bincount(parents).max() <= 10


def test_equal_descriptors_make_one_chain(tmp_path: Path) -> None:
    assert write_vocabulary(tmp_path / "v.txt", [np.zeros((50, 32), np.uint8)], seed=0) == 1
    assert len((tmp_path / "v.txt").read_text().split("\n")) == 1 + 6


def test_a_recording_without_features_has_no_vocabulary(tmp_path: Path) -> None:
    room = SyntheticRoom(0, frames=2, width=32, height=24)
    with pytest.raises(PeerError, match="fewer than 100 ORB features"):
        recorded_descriptors(room)


def test_orbslam3_by_a_program_that_stands_in(box_recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    packages = write_orbslam3(tmp_path / "packages")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(packages), os.environ.get("PYTHONPATH", "")]))
    poses = np.linalg.inv(box_poses()[0]) @ box_poses()
    np.save(tmp_path / "poses.npy", poses)
    monkeypatch.setenv("FAKE_POSES", str(tmp_path / "poses.npy"))
    recording = open_recording(box_recording)
    values = measuring.measure("orbslam3", recording, tmp_path / "out")
    assert (values["version"], values["frames"], values["lost_frames"]) == ("0.0", BOX_FRAMES, 1)
    assert values["ate_m"] < 1e-5  # the file has six digits
    assert values["peak_memory_mb"] > 0
    lines = [line for line in (tmp_path / "out/trajectory.txt").read_text().splitlines() if not line.startswith("#")]
    assert len(lines) == BOX_FRAMES - 1
    assert json.loads((tmp_path / "out/peer.json").read_text()) == values
    monkeypatch.setenv("FAKE_CRASH", "1")
    with pytest.raises(PeerError, match=r"ended after \d+ of 14 frames: killed by SIGSEGV"):
        measuring.measure("orbslam3", recording, tmp_path / "out")


def test_rtabmap_by_a_program_that_stands_in(box_recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stamps = open_recording(box_recording).timestamps
    centres = box_poses()[:, :3, 3]
    lines = ["#timestamp x y z qx qy qz qw id"]
    lines += [f"{t:.6f} {c[0]:.6f} {c[1]:.6f} {c[2]:.6f} 0 0 0 1 {i}" for i, (t, c) in enumerate(zip(stamps, centres)) if i % 2 == 0]
    folder = write_rtabmap(tmp_path / "bin", "RTAB-Map version: 0.21.4\nTotal time=3.5s", "\n".join(lines))
    monkeypatch.setenv("PATH", os.pathsep.join([str(folder), os.environ["PATH"]]))
    values = measuring.measure("rtabmap", open_recording(box_recording), tmp_path / "out")
    assert (values["version"], values["seconds"], values["frames_per_second"], values["lost_frames"]) == ("0.21.4", 3.5, 4.0, 7)
    assert values["ate_m"] < 1e-5
    write_rtabmap(tmp_path / "bin", "no memory", "")
    with pytest.raises(PeerError, match="no memory"):
        measuring.measure("rtabmap", open_recording(box_recording), tmp_path / "out")


def test_frames_are_resampled_to_the_camera_of_rtabmap() -> None:
    """A plane at 2 m whose colour is the ray's slope: it is so in the new camera, too."""
    camera = Camera(160, 120, 140.0, 140.0, 79.5, 59.5)
    slope = np.broadcast_to((np.arange(160) - 79.5) / 140, (120, 160)).astype(np.float32)
    colour, depth = resampled(np.repeat(slope[..., None], 3, 2), np.full((120, 160), 2, np.float32), camera)
    assert colour.shape == (480, 640, 3)
    inside = depth > 0
    assert 0.5 < inside.mean() <= 1
    expected = np.broadcast_to((np.arange(640) - 320.1) / 535.4, (480, 640))
    np.testing.assert_allclose(colour[100:380, 50:590, 0], expected[100:380, 50:590], atol=1e-3)
    assert set(np.unique(depth)) <= {0.0, 2.0}


def test_a_peer_that_is_not_there_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    monkeypatch.setattr("idfslam.benchmark.peers.open3d.has_package", lambda python, package: False)
    monkeypatch.setattr("idfslam.benchmark.peers.orbslam3.has_package", lambda python, package: False)
    assert PEERS["open3d"].missing("/env/bin/python") == "Open3D is not installed: /env/bin/python -m pip install open3d"
    assert PEERS["fusion"].missing("/env/bin/python") == "Open3D is not installed: /env/bin/python -m pip install open3d"
    assert str(PEERS["orbslam3"].missing("/env/bin/python")).endswith("-m pip install pyorbslam3")
    assert "apt install rtabmap" in str(PEERS["rtabmap"].missing(""))
    runs = PeerRuns(["open3d", "rtabmap"])
    assert (runs.names, set(runs.missing)) == (["open3d", "rtabmap"], {"open3d", "rtabmap"})


def test_pythons_of_peers() -> None:
    shell = shutil.which("sh")
    assert chosen(["fusion", "open3d=sh", "rtabmap"]) == {"fusion": shell, "open3d": shell, "rtabmap": sys.executable}
    with pytest.raises(ConfigError, match="nothing is no program that can be run"):
        chosen(["open3d="])
    with pytest.raises(ConfigError, match="/nowhere/python is no program that can be run"):
        chosen(["open3d=/nowhere/python"])
    with pytest.raises(ConfigError, match="open3d stands twice"):
        chosen(["open3d", "open3d=sh"])
    with pytest.raises(ConfigError, match="--against elasticfusion: no known system, expected some of open3d"):
        find_peer("elasticfusion")


@pytest.mark.skipif(find_spec("open3d") is None, reason="Open3D is not installed: pip install 'idf-slam[bench]'")
def test_open3d_follows_a_furnished_room(tmp_path: Path) -> None:
    room = SyntheticRoom(0, frames=6, width=320, height=240)  # aligned by shape alone, Open3D slides along bare walls
    found = measuring.measure("open3d", room, tmp_path / "out", mesh=False)
    assert (found["frames"], found["lost_frames"]) == (6, 0)
    assert found["ate_m"] < 0.01  # of a path of 6 cm; standing still would leave 2 cm
    assert found["frames_per_second"] > 0
