"""Recordings of phones for the tests, as the apps write them: a wall at 1 m, lit with `shade(i)`; poses as in `recordings`."""

import json
import zipfile
from pathlib import Path

import cv2
import lzfse
import numpy as np
from scipy.spatial.transform import Rotation

from helpers.recordings import pose
from helpers.videos import colour_frame, write_video

FLIP_YZ = np.diag([1.0, -1, -1, 1])


def quaternion(T: np.ndarray) -> list[float]:
    """x y z w."""
    return Rotation.from_matrix(T[:3, :3]).as_quat().tolist()


def write_stray(path: Path, *, frames: int = 3, cameras: bool = False, confidence: bool = True) -> Path:
    """Colour 64x48, depth 16x12: no reading at (0, 0), low confidence at (1, 1), medium at (2, 2)."""
    write_video(path / "rgb.mp4", frames=frames)
    for name in ("depth", "confidence"):
        (path / name).mkdir(parents=True)
    columns = ["timestamp", "frame", "x", "y", "z", "qx", "qy", "qz", "qw"]
    lines = [", ".join(columns + (["fx", "fy", "cx", "cy", "distortion_center_x", "distortion_center_y"] if cameras else []))]
    for i in range(frames):
        depth, sure = np.full((12, 16), 1000, np.uint16), np.full((12, 16), 2, np.uint8)
        depth[0, 0], sure[1, 1], sure[2, 2] = 0, 0, 1
        assert cv2.imwrite(str(path / f"depth/{i:06d}.png"), depth)
        if confidence:
            assert cv2.imwrite(str(path / f"confidence/{i:06d}.png"), sure)
        values = [100 + i / 60, i, *pose(i)[:3, 3], *quaternion(pose(i))]
        lines.append(", ".join(map(str, values + ([60 + i, 61 + i, 31.5, 23.5] if cameras else []))) + (", , " if cameras else ""))
    (path / "odometry.csv").write_text("\n".join(lines) + "\n")
    (path / "camera_matrix.csv").write_text("60.0, 0.0, 31.5\n0.0, 60.0, 23.5\n0.0, 0.0, 1.0\n")
    return path


def record3d_entries(frames: int = 3, **changes: object) -> dict[str, bytes]:
    """Colour 48x64, upright, depth 12x16, with the readings of `write_stray`; ARKit's camera has y up and z backwards."""
    arkit = [pose(i) @ FLIP_YZ for i in range(frames)]
    metadata: dict[str, object] = {
        "w": 48, "h": 64, "dw": 12, "dh": 16, "fps": 30,
        "K": [60, 0, 0, 0, 60, 0, 23.5, 31.5, 1],
        "poses": [[*quaternion(T), *T[:3, 3]] for T in arkit],
        "frameTimestamps": [5 + i / 60 for i in range(frames)],
    }  # fmt: skip
    entries = {"metadata": json.dumps(metadata | changes).encode()}
    depth, sure = np.full((16, 12), 1.0, np.float32), np.full((16, 12), 2, np.uint8)
    depth[0, 0], sure[1, 1], sure[2, 2] = np.nan, 0, 1
    for i in range(frames):
        entries[f"rgbd/{i}.jpg"] = cv2.imencode(".jpg", colour_frame(i, (48, 64)))[1].tobytes()
        entries[f"rgbd/{i}.depth"] = lzfse.compress(depth.tobytes())
        entries[f"rgbd/{i}.conf"] = lzfse.compress(sure.tobytes())
    return entries


def write_record3d(path: Path, entries: dict[str, bytes] | None = None) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in (entries or record3d_entries()).items():
            archive.writestr(name, data)
    return path
