"""A run saved while it goes on: its whole state in one safetensors file, written by a thread and put in place when it is complete.

At every moment the folder holds the newest complete checkpoint, whatever ends the process and whenever.
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
from idfslam.errors import ResultError
from idfslam.runs import result_folder
from idfslam.storage import atomic_files
from idfslam.storage.state import State

FORMAT = 7

log = logging.getLogger(__name__)


def made_of(config: Config, recording: Dataset, device: torch.device) -> dict[str, Any]:
    """What a run and the checkpoint that it goes on from must have in common, under the names that a message calls them by."""
    stamps = zlib.crc32(recording.timestamps.tobytes())
    return {
        "version of idf-slam": __version__,
        "device": device.type,
        "number of frames": len(recording),
        "time stamps' checksum": stamps,
        "camera": str(recording.camera),
        **_flat(dump(config)),
    }


class Checkpoints:
    """Keeps the state of a run in its folder: `keep` after a frame copies it and returns, a thread writes.

    A checkpoint that cannot be written is reported, the one before stays, and the run goes on. As a context it waits for the last one.
    """

    def __init__(self, folder: Path, made: dict[str, Any]) -> None:
        self.path, self._made = folder / result_folder.CHECKPOINT, made
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="checkpoint")
        self._pending: Future[None] | None = None

    def __enter__(self) -> "Checkpoints":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._pool.shutdown()

    def keep(self, frames: int, state: State) -> None:
        """Saves the state after so many frames; waits first where the last one is still being written."""
        self.wait()
        tensors: dict[str, Tensor] = {}
        tree = _split(state, "", tensors)
        metadata = {"format": str(FORMAT), "frames": str(frames), "made": json.dumps(self._made), "state": json.dumps(tree)}
        self._pending = self._pool.submit(self._write, frames, tensors, metadata)

    def wait(self) -> None:
        """Until all that was kept is on the disk."""
        if self._pending is not None:
            self._pending.result()

    def remove(self) -> None:
        """The run is over: nothing is left to go on from."""
        self.wait()
        self.path.unlink(missing_ok=True)

    def read(self) -> State | None:
        """The newest state; None where the run had kept none yet. Raises ResultError for a damaged one and for that of another run."""
        if not self.path.exists():
            return None
        try:
            with safe_open(self.path, "pt") as file:
                metadata = file.metadata() or {}
                if metadata.get("format") != str(FORMAT):
                    found = f"checkpoint format {metadata.get('format', 'none')}, expected {FORMAT}"
                    raise ResultError(f"{self.path}: {found}; go on with the version of idf-slam that wrote it, or start the run anew")
                self._compare(json.loads(metadata["made"]))
                return _join(json.loads(metadata["state"]), lambda name: file.get_tensor(name).clone())  # aligned as torch's own
        except (OSError, SafetensorError, KeyError, TypeError, ValueError) as error:
            raise ResultError(f"{self.path}: is damaged ({type(error).__name__}: {error}); start the run anew") from error

    def _write(self, frames: int, tensors: dict[str, Tensor], metadata: dict[str, str]) -> None:
        try:
            with atomic_files.replacing(self.path, durable=True) as part:
                save_file(tensors, part, metadata)
        except (OSError, SafetensorError) as error:
            kept = "the one before stays" if self.path.exists() else "there is none yet"
            log.warning(
                "%s: the checkpoint after frame %d could not be written (%s); %s, and the run goes on", self.path, frames, error, kept
            )

    def _compare(self, found: dict[str, Any]) -> None:
        for name in {**self._made, **found}:
            was, now = found.get(name), self._made.get(name)
            if was != now:
                advice = "go on with what it was begun with, or start the run anew"
                raise ResultError(f"{self.path}: of a run with another {name}: found {was}, expected {now}; {advice}")


def _flat(values: Any, name: str = "") -> dict[str, Any]:
    """Nested values by dotted names."""
    if not isinstance(values, dict):
        return {name: values}
    return {inner: value for key, part in values.items() for inner, value in _flat(part, f"{name}.{key}" if name else key).items()}


def _split(value: Any, name: str, tensors: dict[str, Tensor]) -> Any:
    """Copies of a state's tensors go by their paths into `tensors`; what remains, with their names in their places, is JSON."""
    if isinstance(value, Tensor):
        tensors[name] = value.detach().to("cpu", copy=True).contiguous()
        return {"tensor": name}
    if isinstance(value, dict):
        return {key: _split(inner, f"{name}/{key}" if name else key, tensors) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_split(inner, f"{name}/{i}", tensors) for i, inner in enumerate(value)]
    return value


def _join(tree: Any, tensor: Callable[[str], Tensor]) -> Any:
    """The way back from `_split`."""
    if isinstance(tree, dict):
        return tensor(tree["tensor"]) if tree.keys() == {"tensor"} else {key: _join(inner, tensor) for key, inner in tree.items()}
    return [_join(inner, tensor) for inner in tree] if isinstance(tree, list) else tree
