"""Programs that stand in for those of other systems: packages for the Python that runs the peers, and a command line."""

import stat
import sys
from pathlib import Path

_ORBSLAM3 = '''
"""Each frame has the pose that the file $FAKE_POSES holds for it, and frame 3 is lost."""
import os
from types import SimpleNamespace
import numpy as np

class Sensor:
    RGBD = 2

class Slam:
    def __init__(self, vocabulary, settings, sensor, use_viewer):
        lines = open(vocabulary).read().split("\\n")
        assert lines[0] == "10 6 0 0" and len(lines) > 100 and all(len(line.split()) == 35 for line in lines[1:])
        assert "Camera1.fx: 140.000000" in open(settings).read()
        self.poses, self.stamps = np.load(os.environ["FAKE_POSES"]), []

    def track_rgbd(self, colour, depth, timestamp):
        if os.environ.get("FAKE_CRASH"):
            os.kill(os.getpid(), 11)
        assert colour.dtype == np.uint8 and depth.dtype == np.float32 and depth.max() > 0.5
        i = len(self.stamps)
        self.stamps.append(timestamp)
        return SimpleNamespace(ok=i != 3, pose_wc=self.poses[i])

    def shutdown(self):
        pass

    def save_trajectory_tum(self, path):
        with open(path, "w") as file:
            for i, (t, T) in enumerate(zip(self.stamps, self.poses)):
                half = np.arctan2(T[0, 2], T[0, 0]) / 2
                if i != 3:
                    file.write("%.6f %f %f %f 0 %f 0 %f\\n" % (t, *T[:3, 3], np.sin(half), np.cos(half)))
'''


def write_orbslam3(folder: Path) -> Path:
    """A package pyorbslam3 for PYTHONPATH. Returns the folder."""
    metadata = folder / "pyorbslam3-0.0.dist-info"
    metadata.mkdir(parents=True)
    (folder / "pyorbslam3.py").write_text(_ORBSLAM3)
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: pyorbslam3\nVersion: 0.0\n")
    return folder


def write_rtabmap(folder: Path, output: str, poses: str) -> Path:
    """A command rtabmap-rgbd_dataset that prints `output` and writes `poses`, or ends with 3 where there are none."""
    folder.mkdir(parents=True, exist_ok=True)
    program = folder / "rtabmap-rgbd_dataset"
    program.write_text(
        f"#!{sys.executable}\n"
        "import pathlib, sys\n"
        f"print({output!r})\n"
        "out, sequence = pathlib.Path(sys.argv[sys.argv.index('--output') + 1]), pathlib.Path(sys.argv[-1])\n"
        "assert 'freiburg3' in sequence.name\n"
        "names = [sorted(p.name for p in (sequence / kind).iterdir()) for kind in ('rgb_sync', 'depth_sync')]\n"
        "assert names[0] == names[1] and len(names[0]) == 14\n"
        "out.mkdir()\n"
        f"poses = {poses!r}\n"
        "if not poses:\n    sys.exit(3)\n"
        "(out / 'rtabmap_poses.txt').write_text(poses)\n"
    )
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    return folder
