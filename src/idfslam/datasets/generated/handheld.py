"""A recording of a generated scene by a hand-held camera with the faults of a real sensor, and the exact truth about each of them.

Every fault is a part of its own, drawn from the seed and scaled by its strength; at strength 0 it changes nothing. So the recording
without faults shows the same motion in the same scene, with the same noise of a Kinect.
"""

from dataclasses import replace

import numpy as np
import trimesh
from numpy.typing import NDArray

from idfslam.datasets.generated import corridor_walk
from idfslam.datasets.generated.capture_times import DepthClock, kept_shots
from idfslam.datasets.generated.colour_camera import AutomaticColourCamera, ColourCamera
from idfslam.datasets.generated.depth_camera import ImperfectDepthCamera, SimulatedDepthCamera
from idfslam.datasets.generated.faults import Faults
from idfslam.datasets.generated.handheld_motion import HandheldMotion, Walk
from idfslam.datasets.generated.miscalibration import Miscalibration
from idfslam.datasets.generated.movers import with_movers
from idfslam.datasets.generated.rendered import FPS, pinhole
from idfslam.datasets.generated.room import TOUR, tour_at
from idfslam.datasets.generated.sensor_noise import noisy_colour
from idfslam.datasets.generated.shutter import drawn_readouts, row_times
from idfslam.datasets.provenance import GENERATED, Provenance
from idfslam.errors import ConfigError, FrameError
from idfslam.frame import Frame
from idfslam.geometry.sensor_timing import SYNCHRONISED, UNKNOWN, SensorTiming
from idfslam.scenes.corridor import build_corridor
from idfslam.scenes.moving_scene import AnyScene
from idfslam.scenes.room import build_room
from idfslam.scenes.shading import Rendering

Array = NDArray[np.float64]


class HandheldRecording:
    """`len(recording)`, `recording[i]`, `camera`, `timestamps`, `ground_truth`, `surface()` as of any recording, and the truth.

    A frame depends only on the scene, the walk, `seed`, `faults` and its index. `ground_truth` has the poses of the colour images at their
    middle rows. `camera` is what the recording states. Frames state that their timing is unknown if it has a fault, but for what is
    `known` of it: what a user states.
    """

    provenance = Provenance(GENERATED, stamps=GENERATED)
    reading_threads = 2  # rendering a frame takes several times as long as SLAM does

    def __init__(
        self,
        name: str,
        scene: AnyScene,
        walk: Walk,
        size: tuple[int, int],
        *,
        seed: int,
        frames: int,
        faults: Faults,
        known: SensorTiming = UNKNOWN,
    ) -> None:
        self.name, self.faults = f"{name}-handheld" + ("" if faults == Faults.named(None) else f"-{faults}"), faults
        self._scene, self._seed = scene, seed
        self.motion = HandheldMotion(walk, seed)
        """The true motion, at any time."""
        self.shots = kept_shots(seed, faults.drops, frames)
        """(N,) the number of each frame among all that the camera took: frame i of this recording is frame `shots[i]` of its ideal twin."""
        clock = DepthClock.drawn(seed, faults.time)
        self.timestamps: Array = self.shots / FPS
        self.depth_timestamps: Array = clock.stamps(self.shots)
        """(N,) [s] as the frames state them; depth is taken `true_timing.depth_delay` later."""
        self.true_timing = SensorTiming(*drawn_readouts(seed, faults.shutter), clock.delay)
        stated = UNKNOWN if faults.shutter or faults.time else SYNCHRONISED
        self.timing = replace(stated, **{name: seconds for name, seconds in vars(known).items() if seconds is not None})
        """What the frames state."""
        self.true_camera = pinhole(size)
        self.miscalibration = Miscalibration.drawn(seed, faults.calibration)
        self.camera = self.miscalibration.stated(self.true_camera)
        readout, self._depth_readout = self.true_timing.readout or 0.0, self.true_timing.depth_readout or 0.0
        optics = scene, self.true_camera, self.motion, readout
        self.colour_camera = AutomaticColourCamera(*optics, seed, faults.light) if faults.light else ColourCamera(*optics)
        body = scene, self.true_camera
        self._depth_camera = ImperfectDepthCamera(*body, faults.depth) if faults.depth else SimulatedDepthCamera(*body)
        self.ground_truth: Array = self.motion.pose_at(self.timestamps)

    def __len__(self) -> int:
        return len(self.timestamps)

    def __getitem__(self, index: int) -> Frame:
        """Frame `index`, rendered at each call with the same result. Raises FrameError outside the recording."""
        if not 0 <= index < len(self):
            raise FrameError(f"{self.name}: frame {index} does not exist; it has 0 to {len(self) - 1}")
        shot = int(self.shots[index])
        noise, faults = np.random.default_rng([self._seed, shot]), np.random.default_rng([self._seed, 79, shot])
        depth = self.miscalibration.depth(self._depth_camera.image(self.depth_poses(index), self._depth_taken(index), noise, faults))
        colour = self.colour_camera.image(shot)
        colour = noisy_colour(colour, self.timestamps[index], noise, self.colour_camera.grain(shot))
        stamps = float(self.timestamps[index]), float(self.depth_timestamps[index])
        return Frame(index, stamps[0], colour, depth, self.camera, stamps[1], self.timing)

    def colour_poses(self, index: int) -> Array:
        """True camera-to-world poses of the rows of a colour image, (H, 4, 4); (1, 4, 4) of a global shutter."""
        return self.colour_camera.poses(float(self.timestamps[index]))

    def depth_poses(self, index: int) -> Array:
        """True camera-to-world poses of the rows of a depth image, (H, 4, 4); (1, 4, 4) of a global shutter."""
        return self.motion.pose_at(row_times(self._depth_taken(index), self._depth_readout, self.camera.height))

    def _depth_taken(self, index: int) -> float:
        """[s] the true time of a depth image's middle row."""
        return float(self.depth_timestamps[index] + (self.true_timing.depth_delay or 0.0))

    def exact_depth(self, index: int) -> NDArray[np.float32]:
        """(H, W) [m] what the depth camera scanned, row by row at its true times, without noise, holes and errors of calibration."""
        return self._scene.at(self._depth_taken(index)).render_depth(self.true_camera, self.depth_poses(index))[0]

    def velocity(self, index: int) -> Array:
        """(6,) [m/s, rad/s] the true shift and turn in the camera's frame at a colour image's middle row."""
        return self.motion.velocity_at(float(self.timestamps[index]))

    def exact(self, index: int) -> Rendering:
        """What a camera without any fault or noise sees at `ground_truth[index]`: colour, depth and normals, through `true_camera`."""
        return self._scene.at(float(self.timestamps[index])).render(self.true_camera, self.ground_truth[index])

    def moving(self, index: int) -> NDArray[np.bool_]:
        """(H, W) the pixels of `exact(index)` that show something that moves at some time: people and things, not the scene."""
        return self._scene.moving(self.true_camera, self.ground_truth[index], float(self.timestamps[index]))

    def surface(self) -> trimesh.Trimesh:
        """The true surface in the frame of `ground_truth` [m]; round shapes to within 0.5 mm."""
        return self._scene.surface()


def handheld_room(
    faults: Faults,
    seed: int = 0,
    frames: int = TOUR,
    width: int = 640,
    height: int = 480,
    known: SensorTiming = UNKNOWN,
    *,
    movers: str | None = None,
) -> HandheldRecording:
    """The walk around the room of `SyntheticRoom(seed, movers=movers)` with a shaking hand.

    Raises ConfigError for a negative seed or too small a size.
    """
    if seed < 0 or frames < 1 or width < 8 or height < 8:
        found = f"handheld room {seed} of {frames} frames, {width}x{height} px"
        raise ConfigError(f"{found}; expected a seed >= 0 and at least 1 frame of 8x8 px")
    room = build_room(seed, bare_wall=False)

    def walk(t: Array) -> Array:
        return tour_at(t * FPS, seed, room.half)

    name = f"synthetic-{seed}{'-' + movers if movers else ''}"
    scene = with_movers(movers, room, walk, seed, _longest(seed, faults, frames))
    return HandheldRecording(name, scene, walk, (width, height), seed=seed, frames=frames, faults=faults, known=known)


def handheld_corridor(
    faults: Faults,
    seed: int = 0,
    laps: int = 1,
    frames: int = 0,
    width: int = 320,
    height: int = 240,
    known: SensorTiming = UNKNOWN,
    *,
    movers: str | None = None,
) -> HandheldRecording:
    """The walk through `SyntheticCorridor(seed, movers=movers)` with a shaking hand: `laps` rounds, or `frames` frames if these are more.

    Raises ConfigError for a negative seed, and for a size or a number of laps that is not positive.
    """
    if seed < 0 or laps < 1 or width < 8 or height < 8:
        found = f"handheld corridor {seed}, {laps} laps, {width}x{height} px"
        raise ConfigError(f"{found}; expected a seed >= 0 and at least 1 lap and 8x8 px")
    corridor = build_corridor(seed)
    walk, name = (
        corridor_walk.Walk(seed, corridor.plan),
        f"corridor-{seed}{'-' + movers if movers else ''}{f'-{laps}laps' if laps > 1 else ''}",
    )
    frames = max(frames, corridor_walk.lap_frames(corridor.plan.half, laps))
    scene = with_movers(movers, corridor, walk.pose_at, seed, _longest(seed, faults, frames))
    return HandheldRecording(name, scene, walk.pose_at, (width, height), seed=seed, frames=frames, faults=faults, known=known)


def _longest(seed: int, faults: Faults, frames: int) -> float:
    """[s] the length of a recording of this many frames, with those that are missing."""
    return float(kept_shots(seed, faults.drops, frames)[-1] + 1) / FPS
