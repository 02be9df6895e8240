"""A dataset seen through another camera than the one that it states: for generated recordings, whose images no reader makes."""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from idfslam.datasets.cameras.calibration import Calibration
from idfslam.datasets.images.decoding import Undistortion
from idfslam.datasets.provenance import Provenance
from idfslam.datasets.recording import Dataset, depth_timestamps, reading_threads, timing
from idfslam.frame import Frame

if TYPE_CHECKING:
    import trimesh


class Recalibrated:
    """The frames of a dataset with the camera of a calibration: without its distortion, depth by its scale and without its deformation.

    The dataset's depth is in metres: it has one unit a metre. Raises RecordingError if the calibration is none of its images.
    """

    def __init__(self, dataset: Dataset, calibration: Calibration) -> None:
        self._dataset, self.name, self.timestamps = dataset, dataset.name, dataset.timestamps
        self.camera = calibration.camera(dataset.camera.width, dataset.camera.height, dataset.name)
        self._scale, lens = calibration.depth_scale or 1.0, calibration.distortion or ()
        self._deformation = calibration.deformation
        self._undistort = Undistortion(self.camera, lens) if any(lens) else None
        self.provenance = Provenance(calibration.source, self._scale, distortion=lens, deformation=self._deformation)
        self.depth_timestamps, self.timing = depth_timestamps(dataset), timing(dataset)
        self.reading_threads, self.random_access = reading_threads(dataset), bool(getattr(dataset, "random_access", True))
        self.ground_truth: NDArray[np.float64] | None = dataset.ground_truth

    def __len__(self) -> int:
        return len(self._dataset)

    def __getitem__(self, i: int) -> Frame:
        """Frame i; raises FrameError if the dataset does."""
        frame = self._dataset[i]
        colour, depth = frame.colour, frame.depth * np.float32(1 / self._scale)
        if self._undistort is not None:
            eight_bits = self._undistort.colour(np.rint(colour * 255).astype(np.uint8))
            colour, depth = eight_bits * np.float32(1 / 255), np.asarray(self._undistort.depth(depth), np.float32)
        depth = self._deformation.corrected(depth) if self._deformation else depth
        return replace(frame, colour=colour, depth=depth, camera=self.camera)

    def surface(self) -> "trimesh.Trimesh | None":
        """The dataset's true surface, if known."""
        return self._dataset.surface()
