"""Pretraining of the feature extractor on recordings, with validation, logging and checkpoints, in one or several processes.

All random choices of a pair follow from the seed, the step and the pair's place in the batch. A resumed run therefore trains on the same
pairs as an uninterrupted one, and two processes on the same pairs as one.
"""

import json
import signal
import time
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import numpy as np
import torch
from safetensors.torch import save_file

from idfslam import __version__
from idfslam.compute.devices import resolve_device
from idfslam.compute.interrupt import stop_on_interrupt
from idfslam.config import PretrainConfig
from idfslam.datasets import Dataset
from idfslam.errors import ConfigError, RecordingError, ResultError
from idfslam.pretraining.data_parallel import Workers, workers
from idfslam.pretraining.footage import Footage, FrameSequence, load_footage, sample_pair
from idfslam.pretraining.training import train_step
from idfslam.pretraining.training_log import TrainingLog
from idfslam.pretraining.validation import HeldOut, held_out, validate
from idfslam.storage import atomic_files
from idfslam.tracking.features import FeatureExtractor, load_extractor

Report = Callable[[int, Mapping[str, float]], None]


@dataclass(frozen=True)
class Outputs:
    """The files that a training run writes, and how often."""

    weights: Path  # safetensors, written with each checkpoint
    log: Path | None = None  # folder of TensorBoard's curves
    checkpoint_every: int = 500  # steps; 0: only at the end, and when interrupted
    validate_every: int = 500  # steps; 0: only at the end

    @property
    def checkpoint(self) -> Path:
        """The file of the whole state, next to the weights."""
        return self.weights.with_name(self.weights.name + ".checkpoint")


class Training:
    """The state of training: the extractor's weights, optimiser and learning-rate schedule, and the steps and seconds done."""

    def __init__(self, config: PretrainConfig, crew: Workers, device: torch.device, start: Path | None) -> None:
        self.config, self._crew, self.device = config, crew, device
        self.step, self.seconds = 0, 0.0
        torch.manual_seed(config.seed)
        extractor = FeatureExtractor() if start is None else load_extractor(start)
        self.extractor: FeatureExtractor = extractor.train().to(device, memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.optimiser = torch.optim.Adam(self.extractor.parameters(), lr=config.learning_rate, weight_decay=config.weight_decay)
        self.schedule = torch.optim.lr_scheduler.CosineAnnealingLR(self.optimiser, config.steps)

    def advance(self, footage: Sequence[Footage]) -> dict[str, float]:
        """One optimiser step on a batch of pairs. Returns the mean losses of this process.

        The pairs become harder during training: from near, unchanged views to distant, augmented ones. The losses rest on registration,
        which must work before it can teach.
        """
        config, began = self.config, time.perf_counter()
        ramp = min(1.0, self.step / (config.ramp * config.steps)) if config.ramp > 0 else 1.0
        gap = max(2, round(config.gap * (0.1 + 0.9 * ramp)))
        sums: dict[str, list[float]] = defaultdict(list)
        self.optimiser.zero_grad(set_to_none=True)
        for place in range(self._crew.rank, config.batch, self._crew.count):
            generator = _generator(config.seed, self.step, place)
            pair = sample_pair(footage, gap=gap, crop=config.crop, generator=generator)
            losses = train_step(self.extractor, pair, config, generator, strength=ramp * config.augmentation)
            for name, loss in losses.items():
                sums[name].append(loss)
        self._learn()
        self.schedule.step()
        self.step += 1
        self.seconds += time.perf_counter() - began
        return {name: float(np.mean(values)) for name, values in sums.items()}

    def _learn(self) -> None:
        """An Adam step with the mean gradient of all processes. The statistics of batch normalisation are averaged, too."""
        parameters = list(self.extractor.parameters())
        gradients = [torch.zeros_like(p) if p.grad is None else p.grad for p in parameters]
        self._crew.average([*gradients, *(buffer for buffer in self.extractor.buffers() if buffer.is_floating_point())])
        for parameter, gradient in zip(parameters, gradients):
            parameter.grad = gradient * self._crew.count  # each process has divided by the whole batch, so the sum is the mean
        norm = float(torch.nn.utils.clip_grad_norm_(parameters, 1.0))
        if 0 < norm < float("inf"):  # zero: no pair had a loss; not finite: equal singular values in a Procrustes; both are skipped
            self.optimiser.step()

    def state(self) -> dict[str, Any]:
        """All that the next step depends on."""
        return {
            "extractor": self.extractor.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "schedule": self.schedule.state_dict(),
            "step": self.step,
            "seconds": self.seconds,
            "config": asdict(self.config),
        }

    def restore(self, state: Mapping[str, Any], path: Path) -> None:
        """Continues from a checkpoint's state. Raises ConfigError if it was written with other values."""
        found, expected = state["config"], asdict(self.config)
        for key in expected:
            if found.get(key) != expected[key]:
                flag = "--" + key.replace("_", "-")
                raise ConfigError(f"{path}: made with {flag} {found.get(key)}, found {expected[key]}; resume with the values it began with")
        self.extractor.load_state_dict(state["extractor"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.schedule.load_state_dict(state["schedule"])
        self.step, self.seconds = int(state["step"]), float(state["seconds"])


def pretrain(
    recordings: Sequence[FrameSequence],
    outputs: Outputs,
    config: PretrainConfig,
    *,
    held: Sequence[Dataset] = (),
    start: Path | None = None,
    resume: bool = False,
    overwrite: bool = False,
    report: Report = lambda step, figures: None,
) -> None:
    """Trains an extractor on the recordings, from scratch or from the weights in `start`, and writes its weights.

    held: recordings for validation. resume: continue from the checkpoint next to the weights. overwrite: replace both. `report(steps done,
    values)` is called after each step in the first process, with the losses and, if due, the validation. Ctrl-C ends the run after the step
    with a checkpoint.
    Raises RecordingError for recordings without pairs, ConfigError for invalid values, ResultError if a file cannot be written, the
    checkpoint is missing, or files exist that are not to be replaced, DivergedError for a loss that is not finite.
    """
    if not recordings:
        raise RecordingError("found no recordings, expected at least one to pretrain on; name their folders")
    if min(outputs.checkpoint_every, outputs.validate_every) < 0:
        given = f"--checkpoint-every {outputs.checkpoint_every} --validate-every {outputs.validate_every}"
        raise ConfigError(f"{given}, expected at least 0, which stands for the end alone")
    if outputs.weights.is_dir():
        raise ResultError(f"{outputs.weights}: is a folder, expected the name of a file for the weights: give it with --out")
    if not resume and not overwrite and (found := [path for path in (outputs.weights, outputs.checkpoint) if path.exists()]):
        raise ResultError(f"{found[0]}: exists already; go on with --resume, replace it with --overwrite, or name another file with --out")
    atomic_files.prepare(outputs.weights.parent)
    device = resolve_device(config.device)
    with workers(device) as crew:
        if config.batch % crew.count:
            raise ConfigError(f"--batch {config.batch}: expected a multiple of the {crew.count} processes that share it")
        training = Training(config, crew, device, start)
        if resume:
            training.restore(_read(outputs.checkpoint), outputs.checkpoint)
        log = TrainingLog(outputs.log if crew.first else None, first_step=training.step)
        footage = [load_footage(recording, config.height) for recording in recordings]
        made = {"recordings": [r.name for r in recordings], "frames": sum(map(len, footage)), "start": start and start.name}
        unseen = [held_out(dataset, config) for dataset in held] if crew.first else []
        try:
            _run(training, footage, unseen, outputs, log, crew, made, report)
        finally:
            log.close()


def _run(
    training: Training,
    footage: Sequence[Footage],
    held: Sequence[HeldOut],
    outputs: Outputs,
    log: TrainingLog,
    crew: Workers,
    made: Mapping[str, Any],
    report: Report,
) -> None:
    steps = training.config.steps
    with stop_on_interrupt(signal.SIGTERM) as interrupted:  # SIGTERM: how a cluster's scheduler ends a job
        while training.step < steps:
            figures = training.advance(footage)
            done = training.step
            if held and _due(done, outputs.validate_every, steps):
                figures |= validate(training.extractor, held, training.config)
            if crew.first:
                log.add(done, {**figures, "learning_rate": float(training.optimiser.param_groups[0]["lr"])})
                report(done, figures)
            stop = crew.any(interrupted.is_set(), training.device)
            if crew.first and (stop or _due(done, outputs.checkpoint_every, steps)):
                _write(training, outputs, made)
            if stop:
                raise KeyboardInterrupt


def _due(done: int, every: int, steps: int) -> bool:
    return done == steps or (every > 0 and done % every == 0)


def _generator(*numbers: int) -> torch.Generator:
    """A random generator seeded by all the numbers."""
    return torch.Generator().manual_seed(int(np.random.SeedSequence(numbers).generate_state(1)[0]))


def _write(training: Training, outputs: Outputs, made: Mapping[str, Any]) -> None:
    """Writes the checkpoint, and the weights as safetensors. Their metadata (JSON) says how they were trained."""
    with atomic_files.replacing(outputs.checkpoint) as part:
        torch.save(training.state(), part)
    metadata = {
        "made": {**made, "steps": training.step, "seconds": round(training.seconds), "idfslam": __version__},
        "config": asdict(training.config),
    }
    tensors = {name: tensor.cpu().contiguous() for name, tensor in training.extractor.state_dict().items()}
    with atomic_files.replacing(outputs.weights) as part:
        save_file(tensors, part, metadata={key: json.dumps(value) for key, value in metadata.items()})


def _read(path: Path) -> dict[str, Any]:
    """Reads the state of a checkpoint, without running code in it. Raises ResultError if it is missing or damaged."""
    if not path.is_file():
        raise ResultError(f"{path}: no checkpoint, expected one of an earlier run with the same --out; leave --resume out to begin")
    try:
        state: dict[str, Any] = torch.load(path, map_location="cpu", weights_only=True)
        missing = {"extractor", "optimiser", "schedule", "step", "seconds", "config"} - set(state)
    except (OSError, RuntimeError, UnpicklingError, TypeError, EOFError) as error:
        raise ResultError(
            f"{path}: not a checkpoint of `idf-slam pretrain` ({str(error).splitlines()[0]}); begin without --resume"
        ) from error
    if missing:
        raise ResultError(f"{path}: a checkpoint without {', '.join(sorted(missing))}; begin without --resume")
    return state
