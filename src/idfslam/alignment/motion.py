"""The motion model: constant velocity. It predicts each pose, and keeps the prediction in directions that a measurement leaves open.

A pose can slide along a bare wall and turn about the wall's normal. The noise of the map's normals looks like a little information in these
directions. So the information of each direction is compared with a prior. This is a smooth form of the solution remapping of Zhang, Kaess
and Singh, "On degeneracy of optimization-based state estimation problems", ICRA 2016.

A change of a pose is a 6-vector: the shift [m] of the camera's centre and the turn [rad] about it, both along world axes.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from torch import Tensor

from idfslam.alignment.constants import LEAST_RADIUS, LEAST_VALUE, OPPOSITE, TINY
from idfslam.alignment.row_moments import RowMoments
from idfslam.compute.backend import pick
from idfslam.geometry import se3
from idfslam.storage.state import State, Stateful

# [1] The velocity is updated only along directions with this many times the information that the pose needs. The next frame corrects a
# wrong pose, but a wrong velocity is integrated along a whole bare wall. More: the velocity changes more slowly. Chosen by hand.
_VELOCITY_INFORMATION = 4.0
# [1] Share of an unmeasured turn that is kept from frame to frame: a hand-held camera sways, so its turns end sooner than its walks.
# More: turns go on longer on bare walls. Chosen by hand.
_TURN_KEPT = 0.9


@dataclass(frozen=True)
class Information:
    """The information of a measurement about a pose: eigenvalues and directions."""

    values: Tensor  # (6,) eigenvalues per unit weight, ascending; a turn counts as the shift of a point at the scene's distance
    directions: Tensor  # (6, 6) eigenvectors as orthonormal columns, in the same units
    unit: Tensor  # (6,) units of a shift (1) and of a turn (1 / radius)
    weight: float  # sum of the weights

    @classmethod
    def of(cls, H: Tensor, weight: float, radius: float) -> "Information":
        """The information in normal equations H (6, 6) of points at a mean distance of `radius` [m] whose weights sum to `weight`."""
        unit = np.array([1.0] * 3 + [1 / max(radius, LEAST_RADIUS)] * 3)
        found = np.linalg.eigh(H.numpy() * unit[:, None] * unit / max(weight, 1e-9))  # torch takes ten times as long
        values, directions = (torch.from_numpy(part) for part in found)
        return cls(values, directions, torch.from_numpy(unit), max(weight, 1e-9))

    def prior(self, prior_information: float) -> Tensor:
        """The prior (6, 6) at the guess. It dominates directions with far less than `prior_information`, and vanishes with far more."""
        prior = (self.directions * (prior_information**4 / self.values.clamp(min=LEAST_VALUE * prior_information) ** 3)) @ self.directions.T
        return self.weight * prior / (self.unit[:, None] * self.unit)

    def reliable(self, sums: RowMoments, by_noise: float) -> RowMoments:
        """Normal equations of which this is the information, less the information [1] that noise alone would give in any direction."""
        shares, turned = (1 - by_noise / self.values.clamp(min=by_noise)).sqrt(), self.directions / self.unit[:, None]
        A = ((turned * shares) @ (self.directions * self.unit[:, None]).T).numpy()
        return RowMoments(A @ sums.H @ A.T, sums.b @ (A @ A).T)

    def trusted(self, change: Tensor, prior_information: float) -> Tensor:
        """The part of a change (6,) in directions with more information than `prior_information`; the rest may be noise."""
        share = self.values**4 / (self.values**4 + prior_information**4)  # the weight of the measurement against `prior`
        return self.unit * (self.directions @ (share * (self.directions.T @ (change / self.unit))))


def moved(T: Tensor, change: Tensor) -> Tensor:
    """The pose (4, 4) after a change (6,), both float64 on the host."""
    return pick(T, compiled=compiled_moved, plain=plain_moved)(T, change)


def compiled_moved(T: Tensor, change: Tensor) -> Tensor:
    """`moved` by Numba."""
    from idfslam.alignment.kernels import numba_motion

    out = np.empty((4, 4))
    numba_motion.move(np.ascontiguousarray(T.numpy()), np.ascontiguousarray(change.numpy()), out)
    return torch.from_numpy(out)


def plain_moved(T: Tensor, change: Tensor) -> Tensor:
    """`moved` in numbers of Python."""
    out = T.numpy().copy()
    *shift, x, y, z = change.tolist()  # numbers of Python: numpy takes longer for each operation on three of them
    angle = math.sqrt(x * x + y * y + z * z)
    a, c = (math.sin(angle) / angle, 2 * (math.sin(angle / 2) / angle) ** 2) if angle > TINY else (1.0, 0.5)
    p, q, r = c * x * y, c * x * z, c * y * z
    turn = [
        [-c * (y * y + z * z), p - a * z, q + a * y],
        [p + a * z, -c * (x * x + z * z), r - a * x],
        [q - a * y, r + a * x, -c * (x * x + y * y)],
    ]
    out[:3, :3] += np.array(turn) @ out[:3, :3]  # Rodrigues
    out[:3, 3] += shift
    return torch.from_numpy(out)


def change_between(T: Tensor, other: Tensor) -> Tensor:
    """The change (6,) from a pose to another one, both (4, 4) float64 on the host: moved(T, change) = other."""
    return pick(T, compiled=compiled_change_between, plain=plain_change_between)(T, other)


def compiled_change_between(T: Tensor, other: Tensor) -> Tensor:
    """`change_between` by Numba."""
    from idfslam.alignment.kernels import numba_motion

    change = np.empty(6)
    cosine = numba_motion.change_to(np.ascontiguousarray(T.numpy()), np.ascontiguousarray(other.numpy()), change)
    return torch.from_numpy(change) if cosine > OPPOSITE else plain_change_between(T, other)


def plain_change_between(T: Tensor, other: Tensor) -> Tensor:
    """`change_between` in numbers of Python."""
    of_T, of_other = T.numpy(), other.numpy()
    R = of_other[:3, :3] @ of_T[:3, :3].T
    (a, b, c), (d, e, f), (g, h, i) = R.tolist()
    x, y, z, cosine = (h - f) / 2, (c - g) / 2, (d - b) / 2, (a + e + i - 1) / 2
    sine = math.sqrt(x * x + y * y + z * z)  # x, y and z are the axis times the sine of the angle; near 180 degrees they vanish
    scale = math.atan2(sine, cosine) / sine if sine > TINY else 1.0
    turn = [scale * x, scale * y, scale * z] if cosine > OPPOSITE else Rotation.from_matrix(R).as_rotvec().tolist()
    return torch.from_numpy(np.array([*(of_other[:3, 3] - of_T[:3, 3]).tolist(), *turn]))  # torch takes longer to make one of a list


def image_motion(T: Tensor, other: Tensor, radius: float) -> float:
    """About how far the image moves between two poses (4, 4) [rad]. radius: the scene's distance [m]."""
    return motion_in_image(change_between(T, other).numpy(), radius)


def motion_in_image(change: NDArray[np.float64], radius: float) -> float:
    """About how far the image moves with a change (6,) of the pose [rad]. radius: the scene's distance [m]."""
    x, y, z, *turn = change.tolist()
    return math.hypot(*turn) + math.hypot(x, y, z) / max(radius, LEAST_RADIUS)


class MotionModel(Stateful):
    """The motion from one frame to the next. It is assumed constant."""

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

    def update(self, T_last: Tensor, T_wc: Tensor, information: Information | None = None, prior_information: float = 0.0) -> None:
        """Learns the motion from `T_last` to the pose `T_wc` of the frame after it, both (4, 4).

        information, prior_information: only directions with enough information change the motion. Without information all of them do.
        """
        if information is not None:
            predicted = self.predict(T_last)
            correction = information.trusted(change_between(predicted, T_wc), _VELOCITY_INFORMATION * prior_information)
            step = change_between(T_last, predicted)
            carried = step - information.trusted(step, _VELOCITY_INFORMATION * prior_information)
            carried[3:] *= 1 - _TURN_KEPT
            carried[:3] = 0
            T_wc = moved(moved(T_last, step - carried), correction)
        self.T_step = se3.orthonormal(se3.inverse(T_last) @ T_wc)

    def stop(self) -> None:
        """Forgets the motion: the next prediction is the last pose."""
        self.T_step = torch.eye(4, dtype=torch.float64)
