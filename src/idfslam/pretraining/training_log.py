"""Curves of a training run for TensorBoard."""

from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from idfslam.errors import ConfigError


class TrainingLog:
    """Scalars by step in the event files of a folder; without a folder nothing is written.

    Raises ConfigError where TensorBoard is not installed.
    """

    def __init__(self, folder: Path | None, *, first_step: int = 0) -> None:
        self._writer: Any = None
        if folder is not None:
            if find_spec("tensorboard") is None:
                raise ConfigError("--log needs TensorBoard, which is not installed: pip install 'idf-slam[train]'")
            from torch.utils.tensorboard import SummaryWriter

            self._writer = SummaryWriter(str(folder), purge_step=first_step)  # a resumed run writes anew what came after its checkpoint

    def add(self, step: int, figures: Mapping[str, float]) -> None:
        """One point of each curve."""
        if self._writer is not None:
            for name, value in figures.items():
                self._writer.add_scalar(name, value, step)

    def close(self) -> None:
        """Writes what is left."""
        if self._writer is not None:
            self._writer.close()
