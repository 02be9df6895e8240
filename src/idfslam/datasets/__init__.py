"""Recordings in the layouts of the field, live frames' common interface, and generated recordings; opened by `open_recording`."""

from idfslam.datasets.generated.kidnapped import Kidnapped
from idfslam.datasets.opening import FORMATS, open_recording
from idfslam.datasets.prefetch import Prefetch
from idfslam.datasets.recording import Dataset, FrameSource, Recording, Selection

__all__ = ["FORMATS", "Dataset", "FrameSource", "Kidnapped", "Prefetch", "Recording", "Selection", "open_recording"]
