"""The motion model: constant velocity. It predicts each pose, and keeps the prediction in directions that a measurement leaves open.

A bare wall lets a pose slide along it and turn about its normal, yet the noise of the map's normals looks like a little information there.
So the information of each direction is compared with a prior: a smooth form of the solution remapping of Zhang, Kaess and Singh, "On
degeneracy of optimization-based state estimation problems", ICRA 2016.

Changes of a pose are 6-vectors: the shift [m] of the camera's centre and its turn [rad] about that, both along world axes.
"""

from dataclasses import dataclass

import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from idfslam.alignment.constants import LEAST_RADIUS, LEAST_VALUE
from idfslam.geometry import se3
from idfslam.storage.state import State, Stateful

_VELOCITY_INFORMATION = 4.0  # [1] the velocity follows only directions with this many times the information that the pose needs: the
#                              next frame corrects a wrong pose, but a wrong velocity is integrated along a whole bare wall. More: the
#                              velocity changes more slowly
_TURN_KEPT = 0.9  # [1] share of an unmeasured turn that is kept from frame to frame: hands sway about an upright camera. More:
#                   turns go on longer on bare walls


@dataclass(frozen=True)
class Information:
    """What a measurement knows of a pose, by direction."""

    values: Tensor  # (6,) per unit weight, a turn counting as the shift of a point at the scene's distance
    directions: Tensor  # (6, 6) orthonormal columns, in these units
    unit: Tensor  # (6,) of a shift and a turn
    weight: float  # sum of the weights

    @classmethod
    def of(cls, H: Tensor, weight: float, radius: float) -> "Information":
        """From normal equations H (6, 6) of points at a mean distance of `radius` [m] whose weights sum to `weight`."""
        unit = torch.tensor([1.0] * 3 + [1 / max(radius, LEAST_RADIUS)] * 3, dtype=torch.float64)
        values, directions = torch.linalg.eigh(H * unit[:, None] * unit / max(weight, 1e-9))
        return cls(values, directions, unit, max(weight, 1e-9))

    def prior(self, hold: float) -> Tensor:
        """(6, 6) information that holds a pose to its guess: all of it where a direction's is far below `hold`, none far above."""
        prior = (self.directions * (hold**4 / self.values.clamp(min=LEAST_VALUE * hold) ** 3)) @ self.directions.T
        return self.weight * prior / (self.unit[:, None] * self.unit)

    def trusted(self, change: Tensor, hold: float) -> Tensor:
        """The part of a change (6,) that was measured, not noise in a direction that is open."""
        share = self.values**4 / (self.values**4 + hold**4)  # the share that is left to a measurement beside `prior`
        return self.unit * (self.directions @ (share * (self.directions.T @ (change / self.unit))))


def moved(T: Tensor, change: Tensor) -> Tensor:
    """The pose (4, 4) after a change (6,)."""
    out = T.clone()
    out[:3, :3] = torch.linalg.matrix_exp(se3.hat(change[3:])) @ T[:3, :3]
    out[:3, 3] = T[:3, 3] + change[:3]
    return out


def change_between(T: Tensor, other: Tensor) -> Tensor:
    """(6,) with moved(T, change) = other."""
    turn = Rotation.from_matrix((other[:3, :3] @ T[:3, :3].T).numpy()).as_rotvec()
    return torch.cat([other[:3, 3] - T[:3, 3], torch.from_numpy(turn)])


class MotionModel(Stateful):
    """The motion from one frame to the next, taken for constant."""

    def __init__(self) -> None:
        self.T_step = torch.eye(4, dtype=torch.float64)  # T_c(i-1)_c(i)

    def state(self) -> State:
        """The motion."""
        return {"T_step": self.T_step}

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        self.T_step = state["T_step"]

    def predict(self, T_last: Tensor) -> Tensor:
        """The pose (4, 4) of the frame after `T_last`."""
        return T_last @ self.T_step

    def update(self, T_last: Tensor, T_wc: Tensor, information: Information | None = None, hold: float = 0.0) -> None:
        """The frame after `T_last` was found at `T_wc`: its motion is the next one's, as far as `information` goes (none given: wholly)."""
        if information is not None:
            predicted = self.predict(T_last)
            correction = information.trusted(change_between(predicted, T_wc), _VELOCITY_INFORMATION * hold)
            step = change_between(T_last, predicted)
            carried = step - information.trusted(step, _VELOCITY_INFORMATION * hold)
            carried[3:] *= 1 - _TURN_KEPT
            carried[:3] = 0
            T_wc = moved(moved(T_last, step - carried), correction)
        self.T_step = se3.orthonormal(se3.inverse(T_last) @ T_wc)

    def stop(self) -> None:
        """Nothing is known of the motion any more."""
        self.T_step = torch.eye(4, dtype=torch.float64)
