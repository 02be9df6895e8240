"""SLAM on a generated room, by hand: frames in, poses and a mesh out.

Usage: python examples/slam_in_ten_lines.py [FRAMES] [MESH.ply]
"""

import sys

from idfslam.config import FAST
from idfslam.datasets import open_recording
from idfslam.slam import Slam

frames = int(sys.argv[1]) if len(sys.argv) > 1 else 120
out = sys.argv[2] if len(sys.argv) > 2 else "room.ply"

recording = open_recording("synthetic:0", frames=frames)  # or a folder: see docs
slam = Slam(FAST)
for frame in recording:
    result = slam.process(frame)
    print(frame.index, result.status.value, result.T_wc[:3, 3].round(3))
slam.finish()
slam.mesh(FAST.mesh.resolution).export(out)
