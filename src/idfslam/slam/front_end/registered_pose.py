"""The pose of a view that the tracker registered with a keyframe, as evidence beside that of the map."""

import math
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from idfslam.alignment.alignment import OFF, Alignment, expected_error
from idfslam.alignment.continuous_motion import MotionPrior
from idfslam.alignment.motion import change_between
from idfslam.frame import Status
from idfslam.geometry import se3
from idfslam.graph.keyframe import Keyframe
from idfslam.tracking.tracker import TrackingResult

# [m], [rad] Error that is expected of a registered pose, up to which it confirms another one: twice that is the least that matters. More:
# few patches in a strip of the image confirm poses that are turned about it. Such a strip had 16 cm and 3.7 degrees.
_SURE = 0.025, math.radians(1)


def are_apart(T_wc: Tensor, other: Tensor) -> bool:
    """Whether two poses (4, 4) float64 of one view are so far apart that one of them is wrong."""
    change = change_between(T_wc, other)
    return float(change[:3].norm()) > OFF[0] or float(change[3:].norm()) > OFF[1]


@dataclass(frozen=True)
class RegisteredPose:
    """A view's pose by registration with a keyframe, and the patches of the keyframe's image that confirm it."""

    reference: Keyframe
    result: TrackingResult

    @property
    def T_wc(self) -> Tensor:
        """(4, 4) float64."""
        return self.reference.T_wk @ torch.from_numpy(self.result.T_kc)

    @property
    def covariance(self) -> Tensor | None:
        """(6, 6) float64 of shift [m] and turn [rad] along world axes, against the keyframe; None: unknown."""
        if self.result.covariance is None:
            return None
        R = self.reference.T_wk[:3, :3]
        J = torch.eye(6, dtype=torch.float64)  # the centre moves by the shift, and by the turn about the keyframe
        J[:3, 3:] = -se3.hat(torch.from_numpy(self.result.T_kc[:3, 3]))
        to_world = torch.block_diag(R, R) @ J
        return to_world @ torch.from_numpy(self.result.covariance) @ to_world.T

    def prior(self, motion: MotionPrior) -> MotionPrior:
        """The prior of a frame's motion with this pose instead of the predicted one, as sure as it is. That of the velocity stays.

        The tracker is asked where the prediction, or the pose before, may be wrong: neither holds the pose then.
        """
        if (covariance := self.covariance) is None:
            return motion
        information = np.zeros((12, 12))
        information[:6, :6] = np.linalg.inv(covariance.numpy())
        information[6:, 6:] = np.linalg.inv(np.linalg.inv(motion.information)[6:, 6:])
        return replace(motion, T_wc=self.T_wc, information=information)

    def confirms(self, aligned: Alignment, *, wide: bool = False) -> bool:
        """Whether many patches confirm this pose, which they fix in every direction, and that of an alignment as well.

        wide: after a wide step the views share a part of the image, and patches need not fix every direction.
        """
        return self.result.convinces and (wide or self.is_sure) and self._agrees(aligned)

    @property
    def is_sure(self) -> bool:
        """Whether this pose is hardly off, by its covariance. Patches in a small part of the image may agree at poses far apart."""
        if (covariance := self.covariance) is None:
            return False
        shift, turn = expected_error(covariance)
        return shift <= _SURE[0] and turn <= _SURE[1]

    def refutes(self, aligned: Alignment) -> bool:
        """Whether many patches confirm this pose, and do not confirm that of an alignment, or the alignment is lost."""
        return self.result.convinces and not self._agrees(aligned)

    def is_apart(self, aligned: Alignment) -> bool:
        """Whether this pose and that of an alignment are so far apart that one of them is wrong."""
        return are_apart(aligned.T_wc, self.T_wc)

    def _agrees(self, aligned: Alignment) -> bool:
        T_kc = se3.inverse(self.reference.T_wk) @ aligned.T_wc
        return aligned.status is not Status.LOST and self.result.agrees(T_kc.numpy())
