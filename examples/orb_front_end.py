"""A front end of one's own: ORB and PnP against the last keyframe. `python examples/orb_front_end.py [RECORDING]`"""

import sys

import cv2
import numpy as np
import torch

from idfslam.datasets import open_recording
from idfslam.frame import Frame, Status
from idfslam.slam import FrontEnd, Keyframe, Slam, Source, System, Tracked


class OrbFrontEnd(FrontEnd):
    def __init__(self, system: System) -> None:
        self.graph = system.graph
        self.orb, self.matcher = cv2.ORB_create(1500), cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True)

    def track(self, view: Keyframe) -> Tracked:
        last, c = self.graph.last_keyframe, view.camera
        (u_k, d_k), (u_c, d_c) = self.features(last.frame), self.features(view.frame)
        matches = [] if d_k is None or d_c is None else self.matcher.match(d_k, d_c)
        points = last.camera.backproject(last.depth.cpu()).numpy()  # (H, W, 3) [m]
        pairs = [(points[int(v), int(u)], u_c[m.trainIdx]) for m in matches for u, v in [u_k[m.queryIdx]]]
        p_k, uv = (np.array(column, np.float64) for column in zip(*[pair for pair in pairs if pair[0][2] > 0] or [([], [])]))
        K = np.array([[c.fx, 0, c.cx], [0, c.fy, c.cy], [0, 0, 1]])
        solved, turn, shift, inliers = cv2.solvePnPRansac(p_k, uv, K, None, reprojectionError=2.0) if len(uv) > 12 else (False, 0, 0, [])
        if not solved or inliers is None or len(inliers) < 12:
            return Tracked(view.T_wk, Status.LOST, Source.PREDICTED)
        T_ck = np.block([[cv2.Rodrigues(turn)[0], shift], [np.zeros(3), 1.0]])
        return Tracked(last.T_wk @ torch.from_numpy(np.linalg.inv(T_ck)), Status.OK, Source.REGISTERED)

    def features(self, frame: Frame) -> tuple[np.ndarray, np.ndarray | None]:
        keypoints, descriptors = self.orb.detectAndCompute((frame.colour * 255).astype(np.uint8), None)
        return np.array([k.pt for k in keypoints]), descriptors


if __name__ == "__main__":
    slam = Slam(front_end=OrbFrontEnd)
    print([slam.process(frame).status.value for frame in open_recording((sys.argv[1:] or ["synthetic:0"])[0], frames=60)])
