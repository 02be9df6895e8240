"""The static frames of a ROS recording: a tree of transforms from /tf_static."""

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from idfslam.datasets.poses.pose_file import from_quaternions
from idfslam.errors import RecordingError
from idfslam.geometry.rigid_transform import RIGID, is_rigid


class StaticFrames:
    """Static frames, each with its parent."""

    def __init__(self, messages: Iterable[Any], source: str) -> None:
        """messages: tf2_msgs/TFMessage. source: names them in errors. Raises RecordingError if one is no rigid transform."""
        self._parents: dict[str, tuple[str, NDArray[np.float64]]] = {}
        for message in messages:
            for transform in message.transforms:
                parent, child = (frame.strip("/") for frame in (transform.header.frame_id, transform.child_frame_id))
                self._parents[child] = (parent, matrix(transform.transform.translation, transform.transform.rotation, f"{source}: {child}"))

    def T(self, a: str, b: str) -> NDArray[np.float64] | None:
        """T_ab (4, 4), from frame b to frame a; None if the tree does not connect them."""
        (root_a, T_root_a), (root_b, T_root_b) = self._from_root(a.strip("/")), self._from_root(b.strip("/"))
        return np.linalg.inv(T_root_a) @ T_root_b if root_a == root_b else None

    def _from_root(self, frame: str) -> tuple[str, NDArray[np.float64]]:
        T, seen = np.eye(4), {frame}
        while frame in self._parents:
            frame, T_parent = self._parents[frame]
            T = T_parent @ T
            if frame in seen:
                break  # a cycle instead of a tree
            seen.add(frame)
        return frame, T


def matrix(translation: Any, rotation: Any, source: str) -> NDArray[np.float64]:
    """(4, 4) from a translation and a quaternion; raises RecordingError, which names the source, if they are no rigid transform."""
    t = np.array([[translation.x, translation.y, translation.z]], np.float64)
    q = np.array([[rotation.x, rotation.y, rotation.z, rotation.w]], np.float64)
    T = from_quaternions(t, q)
    if np.isnan(T).any():
        raise RecordingError(f"{source}: a transform that is not finite")
    if not is_rigid(T, tolerance=RIGID)[0]:
        raise RecordingError(f"{source}: a quaternion has length {np.linalg.norm(q):.3g}, expected 1 in a transform")
    return np.asarray(T[0])
