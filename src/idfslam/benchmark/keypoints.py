"""SIFT and ORB keypoints with 3-D points from the depth image: the classic baselines for learned features."""

from dataclasses import dataclass
from typing import Any, Literal

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from idfslam.frame import Frame

Kind = Literal["SIFT", "ORB"]
_COUNT = 1000  # keypoints of an image, at most; more: slower, more matches


@dataclass(frozen=True, eq=False)
class Keypoints:
    """N keypoints that have depth."""

    uv: NDArray[np.float32]  # (N, 2) [px]
    points: NDArray[np.float32]  # (N, 3) in the camera's frame [m]
    descriptors: NDArray[Any]  # (N, 128) float32 or (N, 32) uint8


class KeypointDetector:
    """OpenCV's detector and descriptor of that name, at its defaults."""

    def __init__(self, kind: Kind) -> None:
        opencv: Any = cv2  # its type stubs lack the detectors
        self._detector = opencv.SIFT_create(_COUNT) if kind == "SIFT" else opencv.ORB_create(_COUNT)
        self._norm = cv2.NORM_L2 if kind == "SIFT" else cv2.NORM_HAMMING

    def detect(self, frame: Frame) -> Keypoints:
        """Keypoints of the whole image that have depth."""
        grey = cv2.cvtColor((frame.colour * 255).astype(np.uint8), cv2.COLOR_RGB2GRAY)
        found, descriptors = self._detector.detectAndCompute(grey, None)
        if not found:
            return Keypoints(np.zeros((0, 2), np.float32), np.zeros((0, 3), np.float32), np.zeros((0, 1), np.uint8))
        uv = np.array([point.pt for point in found], np.float32)
        depth = frame.depth[tuple(uv.round().astype(int).T[::-1])]
        points = frame.camera.rays(torch.from_numpy(uv)).numpy() * depth[:, None]
        return Keypoints(uv[depth > 0], points[depth > 0], descriptors[depth > 0])

    def match(self, a: Keypoints, b: Keypoints, limit: int) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """Mutual nearest neighbours: indices (M, 2) into a and b, and ratio weights 1 - d1/d2 (M,), the best `limit` of them."""
        matcher = cv2.BFMatcher(self._norm)
        if min(len(a.uv), len(b.uv)) < 2:
            return np.zeros((0, 2), np.int64), np.zeros(0, np.float32)
        back = {m.queryIdx: m.trainIdx for (m,) in matcher.knnMatch(b.descriptors, a.descriptors, 1)}
        mutual = [(m, second) for m, second in matcher.knnMatch(a.descriptors, b.descriptors, 2) if back[m.trainIdx] == m.queryIdx]
        weight = np.array([1 - m.distance / max(second.distance, 1e-6) for m, second in mutual], np.float32)
        best = np.argsort(-weight, kind="stable")[:limit]
        indices = np.array([(m.queryIdx, m.trainIdx) for m, _ in mutual], np.int64).reshape(-1, 2)
        return indices[best], weight[best]
