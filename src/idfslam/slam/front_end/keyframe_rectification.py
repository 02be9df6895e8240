"""Rectification of stored keyframes: once the sensor's times are known, and again once they are known much better."""

import logging
from collections.abc import Mapping

import numpy as np

from idfslam.alignment.appearances import Appearances
from idfslam.graph.keyframe import Keyframe
from idfslam.sensing.rectification import Rectification, displacement
from idfslam.slam.front_end.temporal_calibration import TemporalCalibration
from idfslam.storage.state import State, Stateful

log = logging.getLogger(__name__)

# All of these were chosen by hand.
# [px] Least displacement by a change of the times for a keyframe to be rectified again. More: keyframes keep what wrong times made of them.
_VISIBLE = 1.0
# [s] Change of an estimated time since stored keyframes were last rectified, from which they are rectified again. More: depth of the first
# keyframes stays longer where wrong times carried it. Less: keyframes are learnt again more often, and lose their landmarks.
_CHANGED = 0.005
# [standard deviations] The same, as far as the estimate is unsure: one that wanders has nothing rectified. Less: as of the former.
_SURELY = 2.0


class KeyframeRectification(Stateful):
    """Rectifies stored keyframes by their velocities and the times of the sensor as they are known by now."""

    def __init__(self, calibration: TemporalCalibration, appearances: Appearances) -> None:
        """appearances: what alignments keep of keyframes' images. They forget those of a keyframe that is rectified."""
        self.calibration, self.appearances = calibration, appearances
        self._rectified_with: dict[str, float] = {}  # estimates [s] when stored keyframes were last rectified

    def state(self) -> State:
        """The times that stored keyframes have."""
        return {"rectified_with": dict(self._rectified_with)}

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        self._rectified_with = dict(state["rectified_with"])

    def is_due(self, index: int) -> bool:
        """Whether the times are known since the frame of this index, or known so much better that stored keyframes must be rectified."""
        now = self.calibration.used() or {}
        if not self._are_news(now):
            return False
        self._rectified_with = now
        found = ", ".join(f"{name} {1000 * value:.0f} ms" for name, value in now.items())
        log.info("frame %d: the sensor's times are estimated: %s", index, found)
        return True

    def _are_news(self, now: Mapping[str, float]) -> bool:
        """Whether an estimate [s] is used, and stored keyframes were rectified without it or with quite another one."""
        then, deviations = self._rectified_with, {name: sigma for name, (_, sigma) in (self.calibration.estimates() or {}).items()}
        least = {name: max(_CHANGED, _SURELY * deviations.get(name, 0.0)) for name in now}
        return any(value and (not then.get(name) or abs(value - then[name]) > least[name]) for name, value in now.items())

    def rectify(self, keyframe: Keyframe) -> bool:
        """Rectifies a keyframe of the time before the sensor's times were known as they are now. Returns whether its images have changed.

        Then the map has to learn it again.
        """
        times = self.calibration.times(keyframe)
        if keyframe.velocity is None or times.synchronised:
            return False
        if (done := keyframe.rectification) is None:
            keyframe.rectify(Rectification(times, keyframe.velocity))
        elif displacement(keyframe.frame, done.velocity, float(np.abs(times.array - done.times.array).max())) < _VISIBLE:
            return False
        else:
            keyframe.rectify_further(times)
        self.appearances.forget(keyframe)
        return True
