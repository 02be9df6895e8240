"""The baseline of the benchmark: Open3D's dense frame-to-model SLAM (`open3d.t.pipelines.slam`) on the CPU.

    python -m idfslam.benchmark.open3d_baseline RECORDING --out FILE.json [--frames N]

The loop and the values are those of Open3D's example dense_slam: each frame is aligned to the rendered model and integrated, and the model
is rendered from the frame's pose. Only Open3D's calls are timed. The times of our own runs include the reading of images.
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from idfslam.datasets import Dataset, open_recording
from idfslam.errors import ConfigError, FrameError, IdfSlamError, pip_install
from idfslam.evaluation.trajectory_error import absolute_trajectory_error
from idfslam.frame import Frame
from idfslam.geometry.camera import Camera
from idfslam.runs.meter import peak_memory
from idfslam.storage import atomic_files

_UNITS = 5000.0  # per metre of the uint16 depth images: up to 13.1 m in steps of 0.2 mm; larger: finer steps, shorter range


@dataclass(frozen=True)
class DenseSlamConfig:
    """The values of Open3D's example."""

    voxel_size: float = 3.0 / 512  # [m]
    block_resolution: int = 16  # voxels along a block
    block_count: int = 40_000
    depth_min: float = 0.1  # [m]
    depth_max: float = 3.0  # [m]
    distance_threshold: float = 0.07  # of matched points [m]
    truncation: float = 8.0  # [voxels]


class DenseSlam:
    """Open3D's model with its input frame and its rendered frame. The world is the first frame's camera."""

    def __init__(self, camera: Camera, config: DenseSlamConfig) -> None:
        import open3d

        o3d: Any = open3d  # its type stubs are stricter than its functions
        self._o3d, self._config = o3d, config
        device = o3d.core.Device("CPU:0")
        K = o3d.core.Tensor(np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]], np.float64))
        self._T_wc = o3d.core.Tensor(np.eye(4))
        slam = o3d.t.pipelines.slam
        self._model = slam.Model(config.voxel_size, config.block_resolution, config.block_count, self._T_wc, device)
        self._input = slam.Frame(camera.height, camera.width, K, device)
        self._rendered = slam.Frame(camera.height, camera.width, K, device)
        self._frames = 0
        self.lost = 0

    def images(self, frame: Frame) -> tuple[Any, Any]:
        """Depth (uint16) and colour (uint8) as images of Open3D; depth beyond the range of uint16 becomes 0."""
        depth = np.round(frame.depth * _UNITS)
        depth[depth > np.iinfo(np.uint16).max] = 0
        colour = np.round(frame.colour * 255).astype(np.uint8)
        image, tensor = self._o3d.t.geometry.Image, self._o3d.core.Tensor
        return image(tensor(depth.astype(np.uint16)[..., None])), image(tensor(colour))

    def process(self, depth: Any, colour: Any) -> NDArray[np.float64]:
        """Processes a frame. Returns T_wc (4, 4). If Open3D finds no motion, the last pose is kept and the frame counts as lost."""
        c, model = self._config, self._model
        self._input.set_data_from_image("depth", depth)
        self._input.set_data_from_image("color", colour)
        if self._frames > 0:
            try:
                motion = model.track_frame_to_model(self._input, self._rendered, _UNITS, c.depth_max, c.distance_threshold)
                self._T_wc = self._T_wc @ motion.transformation
            except RuntimeError:  # its linear system is singular
                self.lost += 1
        model.update_frame_pose(self._frames, self._T_wc)
        model.integrate(self._input, _UNITS, c.depth_max, c.truncation)
        model.synthesize_model_frame(self._rendered, _UNITS, c.depth_min, c.depth_max, c.truncation, False)
        self._frames += 1
        pose: NDArray[np.float64] = self._T_wc.numpy().copy()
        return pose


def require_open3d() -> None:
    """Raises ConfigError if Open3D is not installed."""
    if find_spec("open3d") is None:
        raise ConfigError(f"the comparison needs Open3D, which is not installed: {pip_install('open3d')}")


def measure(recording: Dataset, config: DenseSlamConfig | None = None) -> dict[str, Any]:
    """Runs all frames. Returns frames/s, ATE RMSE [m] if the recording has ground truth, lost frames, and peak memory [MiB].

    An unreadable frame keeps the last pose. Raises ConfigError if Open3D is not installed or does not load.
    """
    require_open3d()
    try:
        import open3d as o3d
    except ImportError as error:  # usually a missing library of the system
        raise ConfigError(f"Open3D is installed but does not load ({error}): install the missing library") from error

    baseline = peak_memory()
    slam = DenseSlam(recording.camera, config or DenseSlamConfig())
    poses, seconds, unreadable = [np.eye(4)], 0.0, 0
    for i in range(len(recording)):
        try:
            frame = recording[i]
            readable = bool(frame.depth.any())
        except FrameError:
            readable = False
        if not readable:  # Open3D tracks by depth
            poses.append(poses[-1])
            unreadable += 1
            continue
        images = slam.images(frame)
        began = perf_counter()
        poses.append(slam.process(*images))
        seconds += perf_counter() - began
    found = {"open3d": o3d.__version__, "frames": len(recording), "seconds": seconds, "frames_per_second": len(recording) / seconds}
    found |= {
        "lost_frames": slam.lost + unreadable,
        "peak_memory_mb": peak_memory(),
        "peak_memory_above_imports_mb": peak_memory() - baseline,
    }
    truth = recording.ground_truth
    if truth is not None and np.isfinite(truth).all((1, 2)).any():
        found["ate_m"] = absolute_trajectory_error(np.stack(poses[1:]), truth).translation.rmse
    return found


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording")
    parser.add_argument("--frames", type=int)
    parser.add_argument("--out", type=Path, required=True)
    flags = parser.parse_args(arguments)
    try:
        atomic_files.write_json(flags.out, measure(open_recording(flags.recording, frames=flags.frames)))
    except IdfSlamError as error:
        print(f"error: {error}", file=sys.stderr)
        raise SystemExit(1) from None


if __name__ == "__main__":
    main()
