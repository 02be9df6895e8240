"""A recording of a walk around a generated corridor, for loop closing, relocalisation among look-alike places, and long runs.

One lap and 2.5 m of the next take 1200 to 1700 frames; the end shows the same places as the beginning.
"""

from idfslam.datasets.generated.corridor_walk import Walk, lap_frames, walk
from idfslam.datasets.generated.movers import with_movers
from idfslam.datasets.generated.rendered import FPS, RenderedRecording
from idfslam.errors import ConfigError
from idfslam.scenes.corridor import build_corridor


class SyntheticCorridor(RenderedRecording):
    """A recording in a corridor; `seed` determines building and walk.

    It has `laps` rounds, each with its own sway, or `frames` frames if these are more. `noise` adds a Kinect's noise to depth and colour.
    `movers` (`movers.PEOPLE` or `MOVERS`) has people or things move before the camera; `surface` leaves them out.
    Raises ConfigError for a negative seed, and for a size or a number of laps that is not positive.
    """

    def __init__(
        self,
        seed: int = 0,
        laps: int = 1,
        frames: int = 0,
        width: int = 320,
        height: int = 240,
        noise: bool = False,
        *,
        movers: str | None = None,
    ) -> None:
        if seed < 0 or laps < 1 or width < 8 or height < 8:
            raise ConfigError(f"corridor {seed}, {laps} laps, {width}x{height} px; expected a seed >= 0 and at least 1 lap and 8x8 px")
        self.corridor = build_corridor(seed)
        plan = self.corridor.plan
        name = f"corridor-{seed}{'-' + movers if movers else ''}{'-noise' if noise else ''}{f'-{laps}laps' if laps > 1 else ''}"
        poses = walk(seed, max(frames, lap_frames(plan.half, laps)), plan)
        scene = with_movers(movers, self.corridor, Walk(seed, plan).pose_at, seed, len(poses) / FPS)
        super().__init__(name, scene, poses, (width, height), seed=seed, noise=noise)
