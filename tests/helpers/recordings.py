"""Small recordings in every layout, for the tests of the readers: one plane at 1 m, red of value 10 + i, green 51, blue 102."""

import json
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

WIDTH, HEIGHT = 16, 12
DEPTH = 1.0  # [m]
SCALE = {"tum": 5000, "icl": 5000, "replica": 6553.5}


def colour_image(i: int, size: tuple[int, int] = (WIDTH, HEIGHT)) -> NDArray[np.uint8]:
    """(H, W, 3) BGR, with a bright border on the left of large images that undistortion moves."""
    image = np.empty((size[1], size[0], 3), np.uint8)
    image[:] = (102, 51, 10 + i)
    if size[0] > 100:
        image[:, :40] = 200
    return image


def depth_image(units: float, size: tuple[int, int] = (WIDTH, HEIGHT)) -> NDArray[np.uint16]:
    """(H, W): 1 m in the given units per metre, no reading in the first pixel."""
    image = np.full((size[1], size[0]), round(units), np.uint16)
    image[0, 0] = 0
    return image


def pose(i: int) -> NDArray[np.float64]:
    """(4, 4) camera-to-world of frame i: a turn of 0.1 i about y and 0.2 i along x."""
    c, s = np.cos(0.1 * i), np.sin(0.1 * i)
    return np.array([[c, 0, s, 0.2 * i], [0, 1, 0, 0.5], [-s, 0, c, 0], [0, 0, 0, 1]])


def freiburg(stamp: str, i: int) -> str:
    """Pose i as a line of TUM: the turn about y is the quaternion (0, sin 0.05 i, 0, cos 0.05 i)."""
    return f"{stamp} {0.2 * i:.7f} 0.5 0 0 {np.sin(0.05 * i):.9f} 0 {np.cos(0.05 * i):.9f}"


def write_images(colour: Path, depth: Path, i: int, units: float, size: tuple[int, int]) -> None:
    for path in (colour, depth):
        path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(colour), colour_image(i, size))
    assert cv2.imwrite(str(depth), depth_image(units, size))


def write_cam_params(path: Path, size: tuple[int, int], scale: float) -> None:
    camera = {"w": size[0], "h": size[1], "fx": 15, "fy": 15, "cx": 7.5, "cy": 5.5, "scale": scale}
    (path / "cam_params.json").write_text(json.dumps({"camera": camera}))


def write_folder(path: Path, *, frames: int = 3, suffix: str = "jpg") -> Path:
    for i in range(frames):
        write_images(path / f"rgb/{i:06d}.{suffix}", path / f"depth/{i:06d}.png", i, 1000, (WIDTH, HEIGHT))
        (path / "pose").mkdir(exist_ok=True)
        np.savetxt(path / f"pose/{i:06d}.txt", pose(i))
    (path / "intrinsics.txt").write_text("15 0 7.5\n0 15 5.5\n0 0 1\n# a comment\n")
    return path


def write_tum(path: Path, *, frames: int = 3, size: tuple[int, int] = (WIDTH, HEIGHT), cam_params: bool = True) -> Path:
    lists: dict[str, list[str]] = {"rgb": ["# a comment"], "depth": ["# a comment"], "groundtruth": ["# a comment"]}
    for i in range(frames):
        stamp = f"{100 + i / 30:.6f}"
        write_images(path / f"rgb/{stamp}.png", path / f"depth/{stamp}.png", i, 5000, size)
        lists["rgb"].append(f"{stamp} rgb/{stamp}.png")
        lists["depth"].append(f"{stamp} depth/{stamp}.png")
        lists["groundtruth"].append(freiburg(stamp, i))
    for name, lines in lists.items():
        (path / f"{name}.txt").write_text("\n".join(lines) + "\n")
    if cam_params:
        write_cam_params(path, size, 5000)
    return path


def write_icl_nuim(path: Path, *, frames: int = 3, size: tuple[int, int] = (WIDTH, HEIGHT), cam_params: bool = True) -> Path:
    associations, truth = [], []
    for i in range(frames):
        write_images(path / f"rgb/{i}.png", path / f"depth/{i}.png", i, 5000, size)
        associations.append(f"{i} depth/{i}.png {i} rgb/{i}.png")
        # in the renderer's frame y points up: height 0.5 below becomes -0.5; a turn about y is the same in both
        truth.append(freiburg(str(i), i).replace(" 0.5 ", " -0.5 "))
    (path / "associations.txt").write_text("\n".join(associations))
    (path / "room.gt.freiburg").write_text("\n".join(truth))
    if cam_params:
        write_cam_params(path, size, 5000)
    return path


def write_replica(path: Path, *, frames: int = 3, size: tuple[int, int] = (WIDTH, HEIGHT), cam_params: bool = True) -> Path:
    for i in range(frames):
        write_images(path / f"results/frame{i:06d}.jpg", path / f"results/depth{i:06d}.png", i, 6553.5, size)
    np.savetxt(path / "traj.txt", np.stack([pose(i).ravel() for i in range(frames)]))
    if cam_params:
        write_cam_params(path, size, 6553.5)
    return path


def write_seven_scenes(path: Path, *, frames: int = 3, size: tuple[int, int] = (WIDTH, HEIGHT), cam_params: bool = True) -> Path:
    for i in range(frames):
        write_images(path / f"frame-{i:06d}.color.png", path / f"frame-{i:06d}.depth.png", i, 1000, size)
        np.savetxt(path / f"frame-{i:06d}.pose.txt", pose(i))
    if cam_params:
        write_cam_params(path, size, 1000)
    return path


def write_scannet(path: Path, *, frames: int = 3, cam_params: bool = True) -> Path:
    for i in range(frames):
        write_images(path / f"color/{i}.jpg", path / f"depth/{i}.png", i, 1000, (WIDTH, HEIGHT))
        (path / "pose").mkdir(exist_ok=True)
        np.savetxt(path / f"pose/{i}.txt", pose(i))
    (path / "intrinsic").mkdir()
    K = [[15, 0, 7.5, 0], [0, 15, 5.5, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
    for name in ("intrinsic_color.txt", "intrinsic_depth.txt"):
        np.savetxt(path / "intrinsic" / name, K)
    if cam_params:
        write_cam_params(path, (WIDTH, HEIGHT), 1000)
    return path


def write_sens(
    path: Path, *, frames: int = 3, colour_codec: str = "jpeg", depth_codec: str = "zlib", stamps: bool = True, poses: bool = True
) -> Path:
    """Version 4; colour is twice as large as depth and sees the same."""
    K_colour = np.array([[30, 0, 15.5, 0], [0, 30, 11.5, 0], [0, 0, 1, 0], [0, 0, 0, 1]], np.float32)
    K_depth = np.array([[15, 0, 7.5, 0], [0, 15, 5.5, 0], [0, 0, 1, 0], [0, 0, 0, 1]], np.float32)
    name, eye = b"StructureSensor", np.eye(4, dtype=np.float32)
    out = struct.pack("<IQ", 4, len(name)) + name
    out += b"".join(matrix.tobytes() for matrix in (K_colour, eye, K_depth, eye))
    out += struct.pack("<2i", {"raw": 0, "png": 1, "jpeg": 2}[colour_codec], {"raw": 0, "zlib": 1, "occi": 2}[depth_codec])
    out += struct.pack("<4IfQ", 2 * WIDTH, 2 * HEIGHT, WIDTH, HEIGHT, 1000.0, frames)
    for i in range(frames):
        image = colour_image(i, (2 * WIDTH, 2 * HEIGHT))
        raw = depth_image(1000).tobytes()
        colour = image[..., ::-1].tobytes() if colour_codec == "raw" else cv2.imencode(f".{colour_codec}", image)[1].tobytes()
        depth = zlib.compress(raw) if depth_codec == "zlib" else raw
        T_wc = pose(i) if poses else np.full((4, 4), -np.inf)
        stamp = 1_000_000 + 33_333 * i if stamps else 0
        out += T_wc.astype(np.float32).tobytes() + struct.pack("<4Q", stamp, stamp, len(colour), len(depth)) + colour + depth
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(out)
    return path
