"""The velocities of keyframes. A keyframe has its own along its camera's axes, so that it turns with it; here they are along world axes."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from idfslam.graph.keyframe import Keyframe
from idfslam.sensing.rectification import along_camera, along_world, turned

Array = NDArray[np.float64]


def give_velocity(keyframe: Keyframe, T_wc: Tensor, velocity: Array, covariance: Array) -> None:
    """Gives a keyframe at `T_wc` (4, 4) a velocity (6,) with its covariance (6, 6)."""
    keyframe.velocity = along_camera(T_wc, velocity)
    keyframe.velocity_covariance = turned(T_wc[:3, :3].T.numpy(), covariance)


def mean_velocity(keyframes: Sequence[Keyframe]) -> Array | None:
    """(6,) of the keyframes that have one; None if none has."""
    velocities = [along_world(k.T_wk, k.velocity) for k in keyframes if k.velocity is not None]
    return np.asarray(np.mean(velocities, 0)) if velocities else None


def unrectified_velocity_moments(keyframe: Keyframe) -> Array:
    """(6, 6) second moments of the velocity that a keyframe's images are still distorted by: what they were not rectified with."""
    assert keyframe.velocity is not None and keyframe.velocity_covariance is not None
    rest = keyframe.velocity if keyframe.rectification is None else keyframe.velocity - keyframe.rectification.velocity
    rest = along_world(keyframe.T_wk, rest)
    return np.asarray(turned(keyframe.T_wk[:3, :3].numpy(), keyframe.velocity_covariance) + np.outer(rest, rest))
