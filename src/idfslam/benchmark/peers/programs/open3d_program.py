"""Open3D on a stream of frames: its dense frame-to-model SLAM, or plain TSDF fusion at given poses. A program of its own.

    PYTHON open3d_program.py slam RESULT.npz          < STREAM
    PYTHON open3d_program.py fuse RESULT.npz DEPTH_MAX < STREAM

`slam` is the loop of Open3D's example dense_slam, with its values: each frame is aligned to the rendered model and integrated, and the
model is rendered from the frame's pose. `fuse` integrates all frames into one grid. Only Open3D's calls are timed.
"""

import sys
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import open3d as o3d
from frame_stream import StreamFrame, StreamHeader, read_frames, read_header
from numpy.typing import NDArray
from result_file import ProgramResult, peak_memory, write_result

_UNITS = 5000.0  # per metre of the uint16 depth images: up to 13.1 m in steps of 0.2 mm; larger: finer steps, shorter range

# The values of Open3D's example dense_slam
_VOXEL = 3.0 / 512  # [m]; larger: coarser and faster
_BLOCK = 16  # voxels along a block; larger: fewer and larger blocks
_BLOCKS = 40_000  # blocks that memory is asked for at first; larger: more memory
_NEAR, _FAR = 0.1, 3.0  # [m] of depth that is used; larger: more of the depth image, or less
_PAIRED = 0.07  # [m] largest distance of matched points; larger: wider convergence, more wrong pairs
_TRUNCATION = 8.0  # [voxels]; larger: thicker and smoother surfaces

_FUSION_VOXEL = 0.01  # [m] of plain fusion, as common in evaluations of surfaces; larger: coarser and faster
_FUSION_TRUNCATION = 4.0  # [voxels]: 4 cm; larger: thicker and smoother surfaces
_LEAST_WEIGHT = 3.0  # [frames] that saw a surface; larger: fewer outliers, less surface. Open3D's default


def images(frame: StreamFrame) -> tuple[Any, Any]:
    """Depth (uint16) and colour (uint8) as images of Open3D; depth beyond the range of uint16 becomes 0."""
    depth = np.round(frame.depth * _UNITS)
    depth[depth > np.iinfo(np.uint16).max] = 0
    image, tensor = o3d.t.geometry.Image, o3d.core.Tensor
    return image(tensor(depth.astype(np.uint16)[..., None])), image(tensor(np.ascontiguousarray(frame.colour)))


def intrinsics(header: StreamHeader) -> Any:
    """The camera matrix (3, 3)."""
    return o3d.core.Tensor(np.array([[header.fx, 0, header.cx], [0, header.fy, header.cy], [0, 0, 1]], np.float64))


def without_surface() -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """The vertices and faces of nothing."""
    return np.zeros((0, 3)), np.zeros((0, 3), np.int64)


def surface(mesh: Any) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """The vertices and faces of a mesh of Open3D."""
    if "positions" not in mesh.vertex or "indices" not in mesh.triangle:
        return without_surface()
    return mesh.vertex.positions.numpy().astype(np.float64), mesh.triangle.indices.numpy().astype(np.int64)


class DenseSlam:
    """Open3D's model with its input frame and its rendered frame. The world is the first frame's camera."""

    def __init__(self, header: StreamHeader) -> None:
        device, slam = o3d.core.Device("CPU:0"), o3d.t.pipelines.slam
        self._T_wc = o3d.core.Tensor(np.eye(4))
        self._model = slam.Model(_VOXEL, _BLOCK, _BLOCKS, self._T_wc, device)
        self._input = slam.Frame(header.height, header.width, intrinsics(header), device)
        self._rendered = slam.Frame(header.height, header.width, intrinsics(header), device)
        self._frames = 0

    def process(self, depth: Any, colour: Any) -> NDArray[np.float64]:
        """Processes a frame. Returns T_wc (4, 4), or NaN if Open3D finds no motion: then the frame is integrated at the last pose."""
        found = True
        self._input.set_data_from_image("depth", depth)
        self._input.set_data_from_image("color", colour)
        if self._frames > 0:
            try:
                motion = self._model.track_frame_to_model(self._input, self._rendered, _UNITS, _FAR, _PAIRED)
                self._T_wc = self._T_wc @ motion.transformation
            except RuntimeError:  # its linear system is singular
                found = False
        self._model.update_frame_pose(self._frames, self._T_wc)
        self._model.integrate(self._input, _UNITS, _FAR, _TRUNCATION)
        self._model.synthesize_model_frame(self._rendered, _UNITS, _NEAR, _FAR, _TRUNCATION, False)
        self._frames += 1
        pose: NDArray[np.float64] = self._T_wc.numpy().copy()
        return pose if found else np.full((4, 4), np.nan)

    def mesh(self) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """The surface of the model."""
        return surface(self._model.voxel_grid.extract_triangle_mesh(_LEAST_WEIGHT))


def slam(header: StreamHeader) -> ProgramResult:
    """Dense SLAM of all frames. A frame without depth has no pose, since Open3D tracks by depth."""
    poses, seconds, system = [], 0.0, DenseSlam(header)
    for frame in read_frames(sys.stdin.buffer, header):
        if not frame.depth.any():
            poses.append(np.full((4, 4), np.nan))
            continue
        taken = images(frame)
        began = perf_counter()
        poses.append(system.process(*taken))
        seconds += perf_counter() - began
    return ProgramResult(np.array(poses), seconds, o3d.__version__, peak_memory(), *system.mesh())


def fuse(header: StreamHeader, depth_max: float) -> ProgramResult:
    """TSDF fusion of all frames that have a pose."""
    grid = o3d.t.geometry.VoxelBlockGrid(
        attr_names=("tsdf", "weight"),
        attr_dtypes=(o3d.core.float32, o3d.core.float32),
        attr_channels=((1), (1)),
        voxel_size=_FUSION_VOXEL,
        block_resolution=_BLOCK,
        block_count=_BLOCKS,
        device=o3d.core.Device("CPU:0"),
    )
    K, poses, seconds = intrinsics(header), [], 0.0
    for frame in read_frames(sys.stdin.buffer, header):
        poses.append(np.full((4, 4), np.nan) if frame.T_wc is None else frame.T_wc)
        if frame.T_wc is None or not frame.depth.any():
            continue
        depth, _ = images(frame)
        T_cw = o3d.core.Tensor(np.linalg.inv(frame.T_wc))
        began = perf_counter()
        blocks = grid.compute_unique_block_coordinates(depth, K, T_cw, _UNITS, depth_max, _FUSION_TRUNCATION)
        grid.integrate(blocks, depth, K, T_cw, _UNITS, depth_max, _FUSION_TRUNCATION)
        seconds += perf_counter() - began
    began = perf_counter()
    mesh = surface(grid.extract_triangle_mesh(_LEAST_WEIGHT)) if seconds else without_surface()
    return ProgramResult(np.array(poses), seconds + perf_counter() - began, o3d.__version__, peak_memory(), *mesh)


if __name__ == "__main__":
    stream = read_header(sys.stdin.buffer)
    write_result(Path(sys.argv[2]), slam(stream) if sys.argv[1] == "slam" else fuse(stream, float(sys.argv[3])))
