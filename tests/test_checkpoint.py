"""Checkpoints: a run that is broken off ends as an unbroken one, to the last bit; what is damaged or foreign is refused."""

import json
import random
import resource
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from safetensors import safe_open
from safetensors.torch import load_file, save_file

from helpers.box_room import BOX_FRAMES
from helpers.differences import differences
from helpers.small_config import small
from helpers.visible_files import visible_files
from idfslam.cli import command_line
from idfslam.config import Config, dump
from idfslam.datasets import open_recording
from idfslam.errors import RecordingError, ResultError
from idfslam.frame import Frame, FrameResult, Status
from idfslam.geometry.trajectory import load_tum
from idfslam.graph.loop_consistency import Loop
from idfslam.runs import result_folder
from idfslam.runs.checkpoint import FORMAT, Checkpoints, fingerprint
from idfslam.runs.frame_log import FrameLog
from idfslam.runs.keyframes_file import read_keyframes
from idfslam.runs.run_config import RecordingSource
from idfslam.runs.runner import resume, run
from idfslam.slam import Slam
from idfslam.storage.ledger import Ledger
from idfslam.storage.state import State

BLANK = (5, 6)  # frames that could not be read
GONE_ON = (0, 4, 5, 9, 12)  # frames after which a run is gone on with: a keyframe, before, in and after the lost ones, near the end


def busy() -> Config:
    """A system in which everything happens within 14 frames: keyframes kept and culled, finetuning, tables that grow."""
    return replace(
        small(),
        field=replace(small().field, table_log2=8, table_log2_max=13),
        mapper=replace(small().mapper, pixels=128, step_pixels=512, first_iterations=20, iterations=4, every=3),
        keyframes=replace(small().keyframes, cull=0.93),
        loops=replace(small().loops, relocalise=False),  # or the camera, once lost, would not be found in so small a map
        finetune=replace(small().finetune, keyframes=2, every=1, pixels=32, learning_rate=1e-3),
    )


def blanked(frame: Frame) -> Frame:
    return Frame.blank(frame.index, frame.timestamp, frame.camera) if frame.index in BLANK else frame


class Unbroken:
    """A run, and Slams that were restored from its checkpoint after each frame and then went on beside it."""

    def __init__(self, recording: Path, folder: Path) -> None:
        self.config, data = busy(), open_recording(recording)
        self.slam, self.restored, self.lost, self.tables = Slam(self.config), list[Slam](), list[str](), list[int]()
        self.results: list[FrameResult] = []
        with Checkpoints(folder, fingerprint(self.config, data, torch.device("cpu"))) as checkpoints:
            for i in range(BOX_FRAMES):
                frame = blanked(data[i])
                for slam in self.restored:
                    slam.process(frame)
                self.results.append(self.slam.process(frame))
                checkpoints.save(i + 1, self.slam.state())
                checkpoints.wait()
                again, state = Slam(self.config), checkpoints.read()
                assert state is not None
                again.restore(state, lambda k: blanked(data[k]))
                self.lost += [f"after frame {i}, {found}" for found in differences(self.slam, again, "slam")]
                if i in GONE_ON:
                    self.restored.append(again)
                self.tables.append(self.slam.mapper.learnt().encoding.tables.shape[1])
        self.poses = self.slam.trajectory()  # before the end moves keyframes
        for slam in (self.slam, *self.restored):
            slam.finish()


@pytest.fixture(scope="module")
def unbroken(box_recording: Path, tmp_path_factory: pytest.TempPathFactory) -> Unbroken:
    return Unbroken(box_recording, tmp_path_factory.mktemp("checkpoints"))


@pytest.mark.slow
def test_everything_happens_in_that_run(unbroken: Unbroken) -> None:
    frames = unbroken.results
    assert [r.index for r in frames if r.status is Status.LOST] == list(BLANK)
    stored = len(unbroken.slam.graph.keyframes)
    assert 3 <= stored < sum(r.keyframe for r in frames) + 1  # with the last frame; some were culled
    assert sum("finetune_depth" in r.losses for r in frames) >= 2
    assert unbroken.tables[-1] > unbroken.tables[0]


@pytest.mark.slow
def test_nothing_that_changes_is_forgotten(unbroken: Unbroken) -> None:
    assert unbroken.lost == []


@pytest.mark.slow
def test_a_restored_run_ends_as_the_unbroken_one(unbroken: Unbroken) -> None:
    for frame, slam in zip(GONE_ON, unbroken.restored, strict=True):
        assert np.array_equal(slam.trajectory(), unbroken.slam.trajectory()), frame
        assert slam.statuses() == unbroken.slam.statuses()
        assert list(differences(slam.mapper, unbroken.slam.mapper, "mapper")) == []
        tracker, other = (each.front_end.registration.tracker for each in (slam, unbroken.slam))
        assert list(differences(tracker, other, "tracker")) == []


def test_what_is_forgotten_would_be_found(box_recording: Path) -> None:
    one, other = Slam(busy()), Slam(busy())
    for slam in (one, other):
        slam.process(open_recording(box_recording)[0])
        slam.timings.clear()
    assert list(differences(one, other, "slam")) == []
    one.front_end.aligner.new = torch.ones(1)
    other.front_end.registration.tracker.generator.manual_seed(9)
    other.graph.keyframes[0].covisible_references.append(3)
    other.back_end.updates.relearn.add(other.graph.keyframes)
    other.mapper.learnt().encoding.tables.data[0, 0, 0] += 1
    places = {found.split(":")[0] for found in differences(one, other, "slam")}
    assert places >= {
        "slam.front_end.aligner.new",
        "slam.graph.keyframes.0.covisible_references.0",
        "slam.graph.last_keyframe.covisible_references.0",
        "slam.back_end.updates.mapper.field.encoding.tables",
        "slam.back_end.updates.mapper.optimiser.field.encoding.tables",
        "slam.back_end.updates.mapper.optimiser.grid.tables",
        "slam.back_end.updates.relearn._left.0",
        "slam.front_end.registration.tracker.generator.state",
    }


def test_what_seldom_changes_is_kept(box_recording: Path, tmp_path: Path) -> None:
    config = replace(busy(), loops=replace(busy().loops, relocalise=True))
    data, slam, again = open_recording(box_recording), Slam(config), Slam(config)
    slam.process(data[0])
    _light, check, local, loop_closer, submap_merger, _camera = slam.back_end.hooks
    loops = [Loop(0, i, torch.rand(4, 4, dtype=torch.float64), 10 * i) for i in (3, 5)]
    loop_closer.loops.closed, loop_closer.loops.waiting, loop_closer.loops.refused = loops[:1], loops[1], 2
    submap_merger.agreeing, submap_merger.merged = loops, 1
    check.max_error, check.contradictions, check.refuted = 0.25, 1, 2
    local._held, local._noise = {0}, np.array([1.5, 0.8])
    slam.recovery.relocalisations, slam.recovery._searched = 3, 4
    tracker = slam.front_end.registration.tracker
    tracker._steps, tracker._registrations, tracker.validator.rollbacks = 4, 3, 1
    for weights in tracker.validator._best[0].values():
        weights += 1
    slam.recovery.relocaliser.descriptor(slam.graph.keyframes[0])
    slam.graph.keyframes[0].unverified = [4, 2]
    slam.graph.unverified_from = 0
    slam.back_end.updates.relearn.add(slam.graph.keyframes)
    with Checkpoints(tmp_path, {}) as checkpoints:
        checkpoints.save(1, slam.state())
        checkpoints.wait()
        state = checkpoints.read()
    assert state is not None
    again.restore(state, lambda i: data[i])
    assert list(differences(slam, again, "slam")) == []


def test_chance_comes_from_generators_that_are_kept(box_recording: Path) -> None:
    data, slam = open_recording(box_recording), Slam(busy())
    before = torch.get_rng_state(), np.random.get_state()[1].tolist(), random.getstate()  # noqa: NPY002 (the global one is meant)
    for i in range(8):
        slam.process(data[i])
    assert torch.equal(torch.get_rng_state(), before[0])
    assert (np.random.get_state()[1].tolist(), random.getstate()) == before[1:]  # noqa: NPY002


def test_other_images_are_refused(box_recording: Path) -> None:
    data, slam = open_recording(box_recording), Slam(small())
    slam.process(data[0])
    with pytest.raises(RecordingError, match="frame 0 has other images"):
        Slam(small()).restore(slam.state(), lambda i: replace(data[1], index=i))


# the file

MADE = {"version of idf-slam": "1", "number of frames": 10, "mapper.pixels": 512}
plain = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text()
tensors = st.lists(st.floats(width=32, allow_nan=False), max_size=4).map(torch.tensor)
nested = st.recursive(plain | tensors, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=4), inner, max_size=3))


@settings(max_examples=25)
@given(state=st.dictionaries(st.sampled_from(["a", "b/c", "d"]), nested))
def test_states_come_back(state: State, tmp_path_factory: pytest.TempPathFactory) -> None:
    with Checkpoints(tmp_path_factory.mktemp("c"), MADE) as checkpoints:
        checkpoints.save(1, state)
        checkpoints.wait()
        assert list(differences(state, checkpoints.read(), "state")) == []


def test_a_copy_is_kept(tmp_path: Path) -> None:
    values = torch.zeros(100_000)
    with Checkpoints(tmp_path, MADE) as checkpoints:
        checkpoints.save(1, {"values": values})
        values += 1  # the run goes on
        checkpoints.wait()
        state = checkpoints.read()
    assert state is not None
    assert not state["values"].any()


@pytest.fixture
def kept(tmp_path: Path) -> Checkpoints:
    checkpoints = Checkpoints(tmp_path, MADE)
    checkpoints.save(5, {"values": torch.arange(1000), "n": 5})
    checkpoints.wait()
    return checkpoints


def test_a_truncated_checkpoint_is_refused(kept: Checkpoints) -> None:
    whole = kept.path.read_bytes()
    for length in (0, 4, 100, len(whole) // 2, len(whole) - 1):
        kept.path.write_bytes(whole[:length])
        with pytest.raises(ResultError, match=r"checkpoint\.safetensors: is damaged .*; start a new run"):
            kept.read()
    kept.path.write_bytes(whole)
    assert kept.read() is not None


def test_every_flipped_bit_is_refused(kept: Checkpoints) -> None:
    """In the header's length, the header with the state, the checksum, and the tensors; nothing is deleted."""
    whole = kept.path.read_bytes()
    end = 8 + int.from_bytes(whole[:8], "little")
    places = {*range(8), *range(8, end, 7), whole.index(b'"sha256":"') + 12, *range(end, len(whole), 97), len(whole) - 1}
    for place in sorted(places):
        for bit in (0, 3, 7):
            flipped = bytearray(whole)
            flipped[place] ^= 1 << bit
            kept.path.write_bytes(flipped)
            with pytest.raises(ResultError, match=r"checkpoint\.safetensors: ") as caught:
                kept.read()
            assert "\n" not in str(caught.value)
            assert kept.path.read_bytes() == flipped


@pytest.mark.parametrize("change", ["more", "dropped", "shape", "dtype", "no checksum", "random"])
def test_another_structure_is_refused(kept: Checkpoints, change: str) -> None:
    tensors, metadata = load_file(kept.path), safe_open(kept.path, "pt").metadata()
    values = tensors["values"]
    if change == "dropped":
        del tensors["values"]
    tensors |= {"more": {"more": values.clone()}, "shape": {"values": values[:9].clone()}, "dtype": {"values": values.half()}}.get(
        change, {}
    )
    save_file(tensors, kept.path, {k: v for k, v in metadata.items() if change != "no checksum" or k != "sha256"})
    if change == "random":
        kept.path.write_bytes(np.random.default_rng(0).bytes(5000))
    with pytest.raises(ResultError, match="is damaged"):
        kept.read()


def test_another_format_is_refused(kept: Checkpoints) -> None:
    save_file(load_file(kept.path), kept.path, {"format": "99"})
    with pytest.raises(ResultError, match=f"checkpoint format 99, expected {FORMAT}"):
        kept.read()
    save_file(load_file(kept.path), kept.path, {"format": str(FORMAT - 1), "made": json.dumps(MADE)})  # before there were checksums
    with pytest.raises(ResultError, match=f"checkpoint format {FORMAT - 1}, expected {FORMAT}"):
        kept.read()
    save_file(load_file(kept.path), kept.path, {"format": str(FORMAT), "made": json.dumps(MADE)})
    with pytest.raises(ResultError, match="is damaged"):
        kept.read()


@pytest.mark.parametrize("name", list(MADE))
def test_that_of_another_run_is_refused(kept: Checkpoints, name: str) -> None:
    other = Checkpoints(kept.path.parent, MADE | {name: "other"})
    with pytest.raises(ResultError, match=f"another {name}: found {MADE[name]}, expected other"):
        other.read()


def test_a_full_disk_leaves_the_checkpoint_before(kept: Checkpoints, caplog: pytest.LogCaptureFixture) -> None:
    before = kept.path.read_bytes()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, limits[1]))  # no file grows beyond: what writes there fails half way
    try:
        kept.save(6, {"values": torch.zeros(100_000)})
        kept.wait()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert kept.path.read_bytes() == before
    assert [path.name for path in kept.path.parent.iterdir()] == [result_folder.CHECKPOINT]
    assert "the checkpoint after frame 6 could not be written" in caplog.text
    assert "the previous one stays, and the run continues" in caplog.text
    kept.save(7, {"n": 7})
    kept.wait()
    assert kept.read() == {"n": 7}


# runs


class Killed(Exception):
    """Ends a run as kill -9 would: no handler knows it."""


class Mortal(Slam):
    """Dies when it is handed frame 9."""

    def process(self, frame: Frame) -> FrameResult:
        if frame.index == 9:
            raise Killed
        return super().process(frame)


@pytest.fixture(scope="module")
def whole(box_recording: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run without a break; not to be changed."""
    return broken(box_recording, tmp_path_factory.mktemp("whole"), Slam)


def broken(recording: Path, folder: Path, slam: Any = Mortal, every: int = 4, *, overwrite: bool = False) -> Path:
    source = RecordingSource(str(recording))
    config = replace(busy(), mesh=replace(busy().mesh, resolution=0.1))
    run(open_recording(recording), config, folder, source=source, make_slam=slam, checkpoint_every=every, overwrite=overwrite)
    return folder


def died(recording: Path, folder: Path, every: int = 4, *, overwrite: bool = False) -> Path:
    with pytest.raises(Killed):
        broken(recording, folder, every=every, overwrite=overwrite)
    return folder


def same(folder: Path, other: Path) -> bool:
    names = (result_folder.TRAJECTORY, result_folder.KEYFRAMES, result_folder.MESH, result_folder.MAP, result_folder.CONFIG)
    return all((folder / name).read_bytes() == (other / name).read_bytes() for name in names)


@pytest.mark.slow
@pytest.mark.parametrize(("every", "resumed_at"), [(4, [8]), (0, [])])
def test_resume(box_recording: Path, whole: Path, tmp_path: Path, every: int, resumed_at: list[int]) -> None:
    died(box_recording, tmp_path, every)
    assert visible_files(tmp_path) == sorted([result_folder.CONFIG, *([result_folder.CHECKPOINT] if resumed_at else [])])
    assert resume(tmp_path, checkpoint_every=every) is not None
    assert same(tmp_path, whole)
    assert visible_files(tmp_path) == sorted(result_folder.FILES)
    metrics = json.loads((tmp_path / result_folder.METRICS).read_text())
    assert (metrics["frames"], metrics["resumed_at"]) == (BOX_FRAMES, resumed_at)
    lines, others = (FrameLog.load(place / result_folder.FRAMES).lines for place in (tmp_path, whole))
    assert [replace(line, ms=0.0) for line in lines] == [replace(line, ms=0.0) for line in others]


@pytest.mark.slow
def test_resume_with_frames_without_depth(box_recording: Path, tmp_path: Path) -> None:
    """One before the break has no depth image, one after it has one without a reading."""
    recording = shutil.copytree(box_recording, tmp_path / "box")
    (recording / "depth/0006.png").unlink()
    cv2.imwrite(str(recording / "depth/0011.png"), np.zeros((120, 160), np.uint16))
    whole = broken(recording, tmp_path / "whole", Slam)
    died(recording, tmp_path / "out")
    assert resume(tmp_path / "out", checkpoint_every=4) is not None
    assert same(tmp_path / "out", whole)
    assert len(load_tum(whole / result_folder.TRAJECTORY)) == BOX_FRAMES
    metrics = json.loads((whole / result_folder.METRICS).read_text())
    assert metrics["unreadable_frames"] == 0
    assert not {6, 11} & set(read_keyframes(whole).indices.tolist())  # without depth there is nothing to map


def test_the_times_of_the_sensor_must_be_those_of_the_run(box_recording: Path) -> None:
    cpu = torch.device("cpu")
    made, other = (fingerprint(small(), open_recording(box_recording, camera={"readout": value}), cpu) for value in (0.02, 0.03))
    assert {name for name in made if made[name] != other[name]} == {"sensor's times"}


@pytest.mark.slow
def test_a_run_that_is_over_says_so(whole: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert resume(whole) is None
    command_line.main(["run", "--resume", str(whole)])
    assert "the run is over, nothing to resume" in " ".join(capsys.readouterr().out.split())


@pytest.mark.slow
def test_ctrl_c_can_be_gone_on_from(box_recording: Path, whole: Path, tmp_path: Path) -> None:
    class Interrupted(Slam):
        def process(self, frame: Frame) -> FrameResult:
            if frame.index == 6:
                signal.raise_signal(signal.SIGINT)
            return super().process(frame)

    broken(box_recording, tmp_path, Interrupted, every=100)
    assert json.loads((tmp_path / result_folder.METRICS).read_text())["interrupted"] is True
    command_line.main(["run", "--resume", str(tmp_path), "--no-report", "-q"])
    assert not (tmp_path / result_folder.REPORT).exists()
    assert same(tmp_path, whole)
    metrics = json.loads((tmp_path / result_folder.METRICS).read_text())
    assert (metrics["interrupted"], metrics["resumed_at"]) == (False, [7])


@pytest.mark.slow
def test_another_config_is_refused(box_recording: Path, tmp_path: Path) -> None:
    died(box_recording, tmp_path)
    values = yaml.safe_load((tmp_path / result_folder.CONFIG).read_text())
    values["mapper"]["pixels"] = 64
    (tmp_path / result_folder.CONFIG).write_text(yaml.safe_dump(values))
    before = (tmp_path / result_folder.CHECKPOINT).read_bytes()
    with pytest.raises(ResultError, match=r"another mapper\.pixels: found 128, expected 64"):
        resume(tmp_path)
    assert (tmp_path / result_folder.CHECKPOINT).read_bytes() == before


@pytest.mark.slow
def test_a_new_run_takes_the_place_of_one_that_was_not_over(box_recording: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    died(box_recording, tmp_path)
    with pytest.raises(ResultError, match=r"holds an unfinished run; continue it with --resume .*, or replace it with --overwrite"):
        died(box_recording, tmp_path, every=0)
    assert (tmp_path / result_folder.CHECKPOINT).exists()
    died(box_recording, tmp_path, every=0, overwrite=True)
    assert "replaces an unfinished run" in caplog.text
    assert not (tmp_path / result_folder.CHECKPOINT).exists()


@pytest.mark.slow
@pytest.mark.parametrize("every", [4, 0])
def test_a_run_that_replaces_another_is_resumed_and_the_other_stays_until_then(
    box_recording: Path, whole: Path, tmp_path: Path, every: int
) -> None:
    earlier = {name: f"the earlier {name}" for name in result_folder.FILES}
    for name, text in earlier.items():
        (tmp_path / name).write_text(text)
    Ledger(tmp_path).record(list(earlier))
    died(box_recording, tmp_path, every, overwrite=True)
    assert {name: (tmp_path / name).read_text() for name in earlier} == earlier
    assert resume(tmp_path) is not None
    assert same(tmp_path, whole)
    assert visible_files(tmp_path) == sorted(result_folder.FILES)


@pytest.mark.slow
def test_a_recording_that_goes_away(box_recording: Path, whole: Path, tmp_path: Path) -> None:
    recording = shutil.copytree(box_recording, tmp_path / "here")

    class Unplugged(Slam):
        def process(self, frame: Frame) -> FrameResult:
            if frame.index == 5:
                recording.rename(tmp_path / "away")
            return super().process(frame)

    folder = tmp_path / "out"
    with pytest.raises(RecordingError, match=r"is gone since frame .*bring it back"):
        broken(recording, folder, Unplugged)
    with pytest.raises(RecordingError, match="no such file or folder"):
        resume(folder)
    (tmp_path / "away").rename(recording)
    assert resume(folder) is not None
    assert (folder / result_folder.TRAJECTORY).read_bytes() == (whole / result_folder.TRAJECTORY).read_bytes()


@pytest.mark.slow
def test_a_full_disk_at_the_end(box_recording: Path, whole: Path, tmp_path: Path) -> None:
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)

    class Filling(Slam):
        def finish(self) -> None:
            super().finish()
            resource.setrlimit(resource.RLIMIT_FSIZE, (0, limits[1]))

    try:
        with pytest.raises(ResultError, match=r"cannot be written .*--resume"):
            broken(box_recording, tmp_path, Filling)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert resume(tmp_path) is not None
    assert same(tmp_path, whole)


@pytest.mark.slow
def test_killed_twice(box_recording: Path, tmp_path: Path) -> None:
    """Kill -9 at whatever happens to go on, after a checkpoint each time; all in processes of their own, as people have it."""
    values = tmp_path / "values.yaml"
    values.write_text(yaml.safe_dump(dump(replace(busy(), mesh=replace(busy().mesh, resolution=0.1)))))
    begin = [sys.executable, "-m", "idfslam.cli", "run"]
    given = [str(box_recording), "--config", str(values), "--checkpoint-every", "3", "--out"]
    subprocess.run([*begin, *given, str(tmp_path / "whole"), "--no-report"], check=True, capture_output=True)

    folder, stamp = tmp_path / "killed", 0
    arguments = [*given, str(folder)]
    for _ in range(2):
        process = subprocess.Popen([*begin, *arguments], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        path = folder / result_folder.CHECKPOINT
        while not path.exists() or path.stat().st_mtime_ns == stamp:
            time.sleep(0.01)
            assert process.poll() is None
        stamp = path.stat().st_mtime_ns
        process.kill()
        process.wait()
        arguments = ["--resume", str(folder), "--checkpoint-every", "3", "--no-report"]
    subprocess.run([*begin, *arguments[:-1]], check=True, capture_output=True)
    assert same(folder, tmp_path / "whole")
    assert visible_files(folder) == sorted([*result_folder.FILES, result_folder.REPORT, result_folder.SCENE, result_folder.PICTURES])
    resumed = json.loads((folder / result_folder.METRICS).read_text())["resumed_at"]
    assert len(resumed) == 2
    assert 3 <= resumed[0] < resumed[1]
