"""A whole pretraining run: weights that load, one seed one result, resuming, two processes, validation, logs, and what goes wrong."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from safetensors import safe_open

from idfslam.config import PretrainConfig, check
from idfslam.datasets import Dataset, open_recording
from idfslam.errors import ConfigError, RecordingError, ResultError
from idfslam.frame import Frame
from idfslam.pretraining.pretraining import Outputs, pretrain
from idfslam.pretraining.training_log import TrainingLog
from idfslam.pretraining.validation import held_out, validate
from idfslam.tracking.features import load_extractor

SMALL = PretrainConfig(steps=4, height=24, crop=(24, 32), gap=3, queries=16, matches=100, seed=4, inliers=0.02, agreement=0.3)


def weights(path: Path) -> dict[str, torch.Tensor]:
    return load_extractor(path).state_dict()


def same(a: Path, b: Path) -> bool:
    first, second = weights(a), weights(b)
    return all(torch.equal(first[name], second[name]) for name in first)


@pytest.fixture(scope="module")
def unbroken(box_recording: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The weights of a whole small run."""
    out = tmp_path_factory.mktemp("unbroken") / "new" / "weights.safetensors"
    pretrain([open_recording(box_recording)], Outputs(out), SMALL)
    return out


def test_it_learns_and_says_how(unbroken: Path) -> None:
    with safe_open(unbroken, "pt") as file:
        made, config = (json.loads(file.metadata()[key]) for key in ("made", "config"))
    assert (made["steps"], made["recordings"], made["frames"], made["start"]) == (4, ["box"], 14, None)
    assert config["seed"] == 4
    torch.manual_seed(4)
    assert not torch.equal(weights(unbroken)["out_conv.0.weight"], type(load_extractor())().state_dict()["out_conv.0.weight"])


def test_one_seed_one_set_of_weights(box_recording: Path, unbroken: Path, tmp_path: Path) -> None:
    pretrain([open_recording(box_recording)], Outputs(tmp_path / "again"), SMALL)
    assert same(tmp_path / "again", unbroken)
    pretrain([open_recording(box_recording)], Outputs(tmp_path / "other"), replace(SMALL, seed=5))
    assert not same(tmp_path / "other", unbroken)


def test_no_pose_is_asked_for(box_recording: Path, unbroken: Path, tmp_path: Path) -> None:
    class Blindfolded:
        """A recording that complains when its poses are asked for."""

        def __init__(self, recording: Dataset) -> None:
            self._recording, self.name, self.camera = recording, recording.name, recording.camera

        def __len__(self) -> int:
            return len(self._recording)

        def __getitem__(self, i: int) -> Frame:
            return self._recording[i]

        @property
        def ground_truth(self) -> None:
            raise AssertionError("pretraining asked for the ground truth")

    pretrain([Blindfolded(open_recording(box_recording))], Outputs(tmp_path / "weights"), SMALL)
    assert same(tmp_path / "weights", unbroken)


def test_an_interrupted_run_resumes_to_the_same_weights(box_recording: Path, unbroken: Path, tmp_path: Path) -> None:
    # Ctrl-C during the second step: that step ends, a checkpoint is written, and the other two follow on resuming.
    outputs, seen = Outputs(tmp_path / "weights.safetensors"), []

    def interrupt(done: int, figures: Mapping[str, float]) -> None:
        seen.append(done)
        if done == 2:
            os.kill(os.getpid(), signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        pretrain([open_recording(box_recording)], outputs, SMALL, report=interrupt)
    assert outputs.checkpoint.is_file()
    assert not same(outputs.weights, unbroken)
    pretrain([open_recording(box_recording)], outputs, SMALL, resume=True, report=lambda done, figures: seen.append(done))
    assert seen == [1, 2, 3, 4]
    assert same(outputs.weights, unbroken)


@pytest.mark.slow
def test_two_processes_learn_what_one_does(box_recording: Path, tmp_path: Path) -> None:
    # A batch of two: one process after another, or two at once. Only the order of sums and the batch norms' statistics differ.
    flags = ["--steps", "2", "--batch", "2", "--height", "24", "--crop", "24", "32", "--gap", "3", "--queries", "16", "--matches", "100"]
    flags += ["--inliers", "0.02", "--agreement", "0.3", "--precision", "fp32"]
    two = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2", "-m", "idfslam.cli"]
    for name, start in (("one", [sys.executable, "-m", "idfslam.cli"]), ("two", two)):
        done = subprocess.run(
            [*start, "pretrain", str(box_recording), "--out", str(tmp_path / name), *flags],
            capture_output=True,
            text=True,
            env={**os.environ, "OMP_NUM_THREADS": "1"},
        )
        assert done.returncode == 0, done.stderr
    one, other = weights(tmp_path / "one"), weights(tmp_path / "two")
    learnt = [name for name in one if "running" not in name and "num_batches" not in name]
    assert max(float((one[name] - other[name]).abs().max()) for name in learnt) < 1e-4  # a step of Adam moves a weight by 1e-3
    torch.manual_seed(0)
    assert float((one["conv.weight"] - type(load_extractor())().state_dict()["conv.weight"]).abs().max()) > 5e-4


def test_validation_needs_no_poses_and_reports_them_where_known(box_recording: Path) -> None:
    held = held_out(open_recording(box_recording), replace(SMALL, height=120, queries=256, inliers=0.2, agreement=0.85))
    assert {gap: len(pairs) for gap, pairs in held.pairs.items()} == {5: 12, 10: 12}  # 14 frames have no pairs 20 apart
    figures = validate(load_extractor(), [held], PretrainConfig())
    assert figures["box/explained-5"] > 0.9
    assert figures["box/within-5"] > 0.9
    assert figures["box/translation-5"] < 5
    few = {gap: pairs[:2] for gap, pairs in held.pairs.items()}
    figures = validate(load_extractor(), [replace(held, T_wc=None, pairs=few)], PretrainConfig())
    assert set(figures) == {"box/explained-5", "box/explained-10"}


def test_validation_leaves_training_as_it_was(box_recording: Path, unbroken: Path, tmp_path: Path) -> None:
    shown: dict[int, Mapping[str, float]] = {}
    outputs = Outputs(tmp_path / "weights", validate_every=2)
    dataset = open_recording(box_recording)
    pretrain([dataset], outputs, SMALL, held=[dataset], report=lambda done, figures: shown.update({done: figures}))
    assert same(outputs.weights, unbroken)
    assert [done for done, figures in shown.items() if "box/explained-5" in figures] == [2, 4]


def test_curves_for_tensorboard(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("tensorboard")
    log = TrainingLog(tmp_path / "log")
    log.add(1, {"contrastive": 2.5})
    log.close()
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    events = EventAccumulator(str(tmp_path / "log"))
    events.Reload()
    assert [(event.step, event.value) for event in events.Scalars("contrastive")] == [(1, 2.5)]
    monkeypatch.setattr("idfslam.pretraining.training_log.find_spec", lambda name: None)
    with pytest.raises(ConfigError, match="-m pip install tensorboard"):
        TrainingLog(tmp_path / "log")


def test_wrong_input(box_recording: Path, unbroken: Path, tmp_path: Path) -> None:
    recordings = [open_recording(box_recording)]
    with pytest.raises(RecordingError, match="found no recordings"):
        pretrain([], Outputs(tmp_path / "weights"), SMALL)
    with pytest.raises(ResultError, match="is a folder, expected the name of a file for the weights"):
        pretrain(recordings, Outputs(tmp_path), SMALL)
    with pytest.raises(ConfigError, match="--checkpoint-every -1 --validate-every 500, expected at least 0"):
        pretrain(recordings, Outputs(tmp_path / "weights", checkpoint_every=-1), SMALL)
    with pytest.raises(ResultError, match="exists already; go on with --resume, replace it with --overwrite, or name another file"):
        pretrain(recordings, Outputs(unbroken), SMALL)
    with pytest.raises(ResultError, match="no checkpoint"):
        pretrain(recordings, Outputs(tmp_path / "weights"), SMALL, resume=True)
    with pytest.raises(ConfigError, match=r"made with --learning-rate 0\.001, found 0\.1"):
        pretrain(recordings, Outputs(unbroken), replace(SMALL, learning_rate=0.1), resume=True)
    (tmp_path / "odd.checkpoint").write_text("not a checkpoint")
    with pytest.raises(ResultError, match="not a checkpoint of"):
        pretrain(recordings, Outputs(tmp_path / "odd"), SMALL, resume=True)
    for bad in (replace(SMALL, batch=0), replace(SMALL, crop=(0, 32)), replace(SMALL, temperature=0.0)):
        with pytest.raises(ConfigError, match="expected"):
            check(bad)
