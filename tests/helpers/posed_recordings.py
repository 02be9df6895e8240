"""Small recordings that state camera and pose of each frame, as programs for phones and for radiance fields write them."""

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from helpers.recordings import HEIGHT, WIDTH, colour_image, depth_image, pose

UP = np.diag([1.0, -1.0, -1.0, 1.0])  # between axes x right, y down, z forward and x right, y up, z backward
K = {"fl_x": 15.0, "fl_y": 15.0, "cx": 8.0, "cy": 6.0, "w": WIDTH, "h": HEIGHT}  # pixel centres at half integers


def write_image(path: Path, image: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), image)


def write_nerfstudio(path: Path, *, frames: int = 3, change: Callable[[dict], object] = lambda values: None) -> Path:
    entries = []
    for i in range(frames):
        write_image(path / f"images/frame_{i:05d}.png", colour_image(i))
        write_image(path / f"depth/frame_{i:05d}.png", depth_image(1000))
        files = {"file_path": f"./images/frame_{i:05d}.png", "depth_file_path": f"depth/frame_{i:05d}.png"}
        entries.append({**files, "transform_matrix": (pose(i) @ UP).tolist()})
    values = {"camera_model": "OPENCV", **K, "frames": entries}
    change(values)
    (path / "transforms.json").write_text(json.dumps(values))
    return path


def write_nerf_capture(path: Path) -> Path:
    """Names without a suffix, depth in 10 m / 65535, the frames in no order, stamps."""
    entries = []
    for i in (2, 0, 1):
        write_image(path / f"images/{i}.png", colour_image(i))
        write_image(path / f"images/{i}.depth.png", depth_image(6553.5))
        entries.append({"file_path": f"images/{i}", "depth_path": f"images/{i}.depth.png", "timestamp": 50 + i / 10, **K})
        entries[-1]["transform_matrix"] = (pose(i) @ UP).tolist()
    (path / "transforms.json").write_text(json.dumps({"integer_depth_scale": 10 / 65535, "frames": entries}))
    return path


def write_polycam(path: Path, *, frames: int = 3, corrected: bool = True) -> Path:
    """Colour of 64x48, depth and confidence of 16x12; the last row of depth is a guess."""
    prefix, folder = "corrected_" if corrected else "", path / "keyframes"
    confidence = np.full((12, 16), 255, np.uint8)
    confidence[-1] = 0
    for i in range(frames):
        stamp = 4872498736 + 100_000 * i
        write_image(folder / f"{prefix}images/{stamp}.jpg", colour_image(i, (64, 48)))
        write_image(folder / f"depth/{stamp}.png", depth_image(1000, (16, 12)))
        write_image(folder / f"confidence/{stamp}.png", confidence)
        T = pose(i) @ UP
        values = {"fx": 60.0, "fy": 60.0, "cx": 31.5, "cy": 23.5, "width": 64, "height": 48, "timestamp": stamp}
        values |= {f"t_{r}{c}": T[r, c] for r in range(3) for c in range(4)}
        (folder / f"{prefix}cameras").mkdir(exist_ok=True)
        (folder / f"{prefix}cameras/{stamp}.json").write_text(json.dumps(values))
    return path


def write_scanner_app(path: Path, *, frames: int = 3) -> Path:
    for i in range(frames + 1):
        write_image(path / f"depth_{i:05d}.png", depth_image(1000, (16, 12)))
        write_image(path / f"conf_{i:05d}.png", np.array([[0] * 16 if row == 11 else [2] * 16 for row in range(12)], np.uint8))
        state = {
            "intrinsics": [60, 0, 31.5, 0, 60, 23.5, 0, 0, 1],
            "cameraPoseARFrame": (pose(i) @ UP).ravel().tolist(),
            "time": 7 + i / 10,
        }
        (path / f"frame_{i:05d}.json").write_text(json.dumps(state))
        if i < frames:
            write_image(path / f"frame_{i:05d}.jpg", colour_image(i, (64, 48)))
    return path


def write_frame_lines(
    path: Path, *, frames: int = 3, dtype: type = np.float32, change: Callable[[dict, int], object] = lambda values, i: None
) -> Path:
    """Raw depth of 16x12 beside colour of 64x48; ARKit's matrices by columns."""
    lines = []
    for i in range(frames):
        write_image(path / f"rgb/{i:06d}.jpg", colour_image(i, (64, 48)))
        raw = depth_image(1000, (16, 12))
        (path / "depth").mkdir(exist_ok=True)
        (path / f"depth/{i:06d}.bin").write_bytes((raw / np.float32(1000) if dtype == np.float32 else raw).astype(dtype).tobytes())
        K = [60, 0, 0, 0, 60, 0, 31.5, 23.5, 1]
        values = {"frame": i, "timestamp": 3 + i / 10, "intrinsics": K, "transform": (pose(i) @ UP).T.ravel().tolist()}
        change(values, i)
        lines.append(json.dumps(values))
    (path / "frames.jsonl").write_text("\n".join(lines) + "\n")
    return path


def by_names(values: dict, i: int) -> None:
    """Files named, values in other forms."""
    values.update(image=f"rgb/{i:06d}.jpg", depth_path=f"depth\\{i:06d}.bin", pose=(pose(i) @ UP).tolist())
    values.update(intrinsics={"fx": 60, "fy": 60, "cx": 31.5, "cy": 23.5})
    del values["transform"], values["frame"]
