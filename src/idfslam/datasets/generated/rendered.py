"""A recording of a generated scene, whose frames are rendered on request, exactly or with a Kinect's noise."""

import numpy as np
import trimesh
from numpy.typing import NDArray

from idfslam.datasets.generated.sensor_noise import noisy_colour, noisy_depth
from idfslam.datasets.provenance import GENERATED, Provenance
from idfslam.errors import FrameError
from idfslam.frame import Frame
from idfslam.geometry.camera import Camera
from idfslam.scenes.moving_scene import AnyScene
from idfslam.scenes.shading import Rendering

FPS = 30.0  # [Hz] of generated recordings; raised, a walk through the corridor has more frames
_FOCAL = 577.0  # [px] for a width of 640, about a Kinect's; raised, the field of view is narrower


class RenderedRecording:
    """`len(recording)`, `recording[i]`, `camera`, `timestamps`, `ground_truth`, `surface()` of a scene seen from given poses.

    A frame depends only on `seed`, its index and its pose. `noise` adds a Kinect's noise to depth and colour.
    """

    provenance = Provenance(GENERATED, stamps=GENERATED)
    reading_threads = 2  # rendering a frame takes several times as long as SLAM does

    def __init__(
        self,
        name: str,
        scene: AnyScene,
        ground_truth: NDArray[np.float64],
        size: tuple[int, int],
        *,
        seed: int,
        noise: bool,
    ) -> None:
        self.name = name
        self.camera = pinhole(size)
        self.timestamps: NDArray[np.float64] = np.arange(len(ground_truth)) / FPS
        self.ground_truth: NDArray[np.float64] = ground_truth
        self._scene, self._seed, self._noise = scene, seed, noise

    def __len__(self) -> int:
        return len(self.timestamps)

    def __getitem__(self, index: int) -> Frame:
        """Frame `index`, rendered at each call with the same result. Raises FrameError outside the recording."""
        if not 0 <= index < len(self):
            raise FrameError(f"{self.name}: frame {index} does not exist; it has 0 to {len(self) - 1}")
        rendering = self.render(self.ground_truth[index], seconds=self.timestamps[index])
        colour, depth = rendering.colour, rendering.depth
        if self._noise:
            rng = np.random.default_rng([self._seed, index])
            depth = noisy_depth(depth, rendering.normals, self.camera, rng)
            colour = noisy_colour(colour, self.timestamps[index], rng)
        return Frame(index, float(self.timestamps[index]), colour, depth, self.camera)

    def render(self, T_wc: NDArray[np.float64], camera: Camera | None = None, *, seconds: float = 0.0) -> Rendering:
        """Exact colour, depth and normals from any camera-to-world pose (4, 4), at a time if something moves."""
        return self._scene.at(seconds).render(camera or self.camera, T_wc)

    def moving(self, index: int) -> NDArray[np.bool_]:
        """(H, W) the pixels of frame `index` that show something that moves at some time: people and things, not the scene."""
        return self._scene.moving(self.camera, self.ground_truth[index], float(self.timestamps[index]))

    def surface(self) -> trimesh.Trimesh:
        """The true surface in the frame of `ground_truth` [m]; round shapes to within 0.5 mm."""
        return self._scene.surface()


def pinhole(size: tuple[int, int]) -> Camera:
    """The camera of generated recordings for images of this width and height [px]."""
    width, height = size
    return Camera(width, height, _FOCAL * width / 640, _FOCAL * width / 640, (width - 1) / 2, (height - 1) / 2)


def poses_looking(
    position: NDArray[np.float64], yaw: NDArray[np.float64], pitch: NDArray[np.float64], roll: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Camera-to-world poses (N, 4, 4) at `position` (N, 3) [m] from angles (N,) [rad]: yaw about z from x, pitch upwards, roll."""
    forward = np.stack([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), np.sin(pitch)], 1)
    right = np.stack([np.sin(yaw), -np.cos(yaw), np.zeros_like(yaw)], 1)
    down = np.cross(forward, right)
    c, s = np.cos(roll)[:, None], np.sin(roll)[:, None]
    poses = np.tile(np.eye(4), (len(yaw), 1, 1))
    poses[:, :3, 0], poses[:, :3, 1], poses[:, :3, 2] = c * right + s * down, c * down - s * right, forward
    poses[:, :3, 3] = position
    return poses
