"""Recordings in common layouts and generated ones, opened by `open_recording`; the interface that live cameras share with them."""

from idfslam.datasets.generated.kidnapped import Kidnapped
from idfslam.datasets.opening import FORMATS, open_recording
from idfslam.datasets.prefetch import Prefetch
from idfslam.datasets.recording import Dataset, FrameSource, Recording, Selection

__all__ = ["FORMATS", "Dataset", "FrameSource", "Kidnapped", "Prefetch", "Recording", "Selection", "open_recording"]
