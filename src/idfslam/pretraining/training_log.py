"""Logs the curves of a training run for TensorBoard."""

from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from idfslam.errors import ConfigError, pip_install


class TrainingLog:
    """Writes scalars to the event files of a folder; without a folder it writes nothing.

    Raises ConfigError if TensorBoard is not installed.
    """

    def __init__(self, folder: Path | None, *, first_step: int = 0) -> None:
        self._writer: Any = None
        if folder is not None:
            if find_spec("tensorboard") is None:
                raise ConfigError(f"--log needs TensorBoard, which is not installed: {pip_install('tensorboard')}")
            from torch.utils.tensorboard import SummaryWriter

            self._writer = SummaryWriter(str(folder), purge_step=first_step)  # drops curves after a resumed checkpoint

    def add(self, step: int, figures: Mapping[str, float]) -> None:
        """One point of each curve."""
        if self._writer is not None:
            for name, value in figures.items():
                self._writer.add_scalar(name, value, step)

    def close(self) -> None:
        """Writes what is still buffered."""
        if self._writer is not None:
            self._writer.close()
