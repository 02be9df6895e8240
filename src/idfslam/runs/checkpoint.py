"""Checkpoints: the whole state of a run in one safetensors file.

A thread writes each checkpoint and moves it into place when it is complete, so the folder holds a complete one however the process ends.
"""

import json
import logging
import zlib
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from types import TracebackType
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from idfslam import __version__
from idfslam.config import Config, dump
from idfslam.datasets import Dataset
from idfslam.datasets.recording import depth_timestamps, timing
from idfslam.errors import ResultError
from idfslam.runs import result_folder
from idfslam.storage import atomic_files, safetensors_file
from idfslam.storage.state import State

_SHOWN = 200  # characters of a library's error in a message; more: a longer line
FORMAT = 24  # counts up whenever the state of a part changes its form

log = logging.getLogger(__name__)


def fingerprint(config: Config, recording: Dataset, device: torch.device) -> dict[str, Any]:
    """The values that must be equal in a run and in the checkpoint that it resumes from; the keys are their names in messages."""
    depth_stamps = depth_timestamps(recording)
    stamps = zlib.crc32(b"" if depth_stamps is None else depth_stamps.tobytes(), zlib.crc32(recording.timestamps.tobytes()))
    return {
        "version of idf-slam": __version__,
        "device": device.type,
        "number of frames": len(recording),
        "time stamps' checksum": stamps,
        "camera": str(recording.camera),
        "sensor's times": str(timing(recording)),
        **_flat(dump(config)),
    }


class Checkpoints:
    """The checkpoint of a run in its folder. `save` copies the state and returns; a thread writes the file.

    A checkpoint that cannot be written is reported, the previous one stays, and the run continues. On leaving the `with` block the last
    write is waited for.
    """

    def __init__(self, folder: Path, fingerprint: dict[str, Any] | None, *, every: int = 0) -> None:
        """fingerprint: None for a run that cannot be resumed; it has no checkpoints. every: frames between checkpoints; 0: none."""
        self.path, self.enabled, self._every = folder / result_folder.CHECKPOINT, fingerprint is not None, every
        self._fingerprint = fingerprint or {}
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="checkpoint")
        self._pending: Future[None] | None = None

    def __enter__(self) -> "Checkpoints":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._pool.shutdown()

    def due(self, frames: int, *, stopping: bool = False) -> bool:
        """Whether a checkpoint is to be saved after so many frames; always if the run is stopping."""
        return self.enabled and self._every > 0 and (stopping or frames % self._every == 0)

    def save(self, frames: int, state: State) -> None:
        """Saves the state after `frames` frames; waits first if the previous one is still being written."""
        self.wait()
        tensors: dict[str, Tensor] = {}
        tree = _split(state, "", tensors)
        metadata = {"format": str(FORMAT), "frames": str(frames), "made": json.dumps(self._fingerprint), "state": json.dumps(tree)}
        metadata["sha256"] = safetensors_file.UNKNOWN
        self._pending = self._pool.submit(self._write, frames, tensors, metadata)

    def wait(self) -> None:
        """Waits until everything saved is on the disk."""
        if self._pending is not None:
            self._pending.result()

    def remove(self) -> None:
        """Deletes the checkpoint of a completed run."""
        self.wait()
        self.path.unlink(missing_ok=True)

    def read(self) -> State | None:
        """The newest state; None if there is no checkpoint. Raises ResultError if it is damaged or of another run."""
        if not self.path.exists():
            return None
        try:
            intact = safetensors_file.is_intact(self.path)
            if intact is False:
                raise ValueError("its checksum is not that of its content")
            with safe_open(self.path, "pt") as file:
                metadata = file.metadata() or {}
                if metadata.get("format") != str(FORMAT):
                    found = f"checkpoint format {metadata.get('format', 'none')}, expected {FORMAT}"
                    raise ResultError(f"{self.path}: {found}; resume with the version of idf-slam that wrote it, or start a new run")
                if intact is None:
                    raise ValueError("it has no checksum")
                self._compare(json.loads(metadata["made"]))
                return _join(json.loads(metadata["state"]), lambda name: file.get_tensor(name).clone())  # a copy is aligned as torch's own
        except (OSError, SafetensorError, KeyError, TypeError, ValueError) as error:
            found = " ".join(str(error).split())[:_SHOWN] or type(error).__name__
            raise ResultError(f"{self.path}: is damaged ({found}); start a new run") from error

    def _write(self, frames: int, tensors: dict[str, Tensor], metadata: dict[str, str]) -> None:
        try:
            with atomic_files.replacing(self.path, durable=True) as part:
                save_file(tensors, part, metadata)
                safetensors_file.seal(part)
        except (OSError, SafetensorError) as error:
            kept = "the previous one stays" if self.path.exists() else "there is none yet"
            log.warning(
                "%s: the checkpoint after frame %d could not be written (%s); %s, and the run continues", self.path, frames, error, kept
            )

    def _compare(self, stored: dict[str, Any]) -> None:
        """Raises ResultError at the first value in which the checkpoint's run differs from this one."""
        for name in {**self._fingerprint, **stored}:
            was, now = stored.get(name), self._fingerprint.get(name)
            if was != now:
                advice = "resume with the values that the run was started with, or start a new run"
                raise ResultError(f"{self.path}: of a run with another {name}: found {was}, expected {now}; {advice}")


def _flat(values: Any, name: str = "") -> dict[str, Any]:
    """Nested values as one dict with dotted names."""
    if not isinstance(values, dict):
        return {name: values}
    return {inner: value for key, part in values.items() for inner, value in _flat(part, f"{name}.{key}" if name else key).items()}


def _split(value: Any, name: str, tensors: dict[str, Tensor]) -> Any:
    """Copies a state's tensors into `tensors` by their paths. Returns the state with names instead of tensors, which JSON can hold."""
    if isinstance(value, Tensor):
        tensors[name] = value.detach().to("cpu", copy=True).contiguous()
        return {"tensor": name}
    if isinstance(value, dict):
        return {key: _split(inner, f"{name}/{key}" if name else key, tensors) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_split(inner, f"{name}/{i}", tensors) for i, inner in enumerate(value)]
    return value


def _join(tree: Any, tensor: Callable[[str], Tensor]) -> Any:
    """The inverse of `_split`."""
    if isinstance(tree, dict):
        return tensor(tree["tensor"]) if tree.keys() == {"tensor"} else {key: _join(inner, tensor) for key, inner in tree.items()}
    return [_join(inner, tensor) for inner in tree] if isinstance(tree, list) else tree
