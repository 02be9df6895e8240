"""A recording of a walk round a generated corridor: for closing loops, for finding a place again among like ones, for long runs.

One lap and 2.5 m of the next take 1200 to 1700 frames; the places seen at its end are those of its beginning.
"""

from idfslam.datasets.generated.corridor_walk import lap_frames, walk
from idfslam.datasets.generated.rendered import RenderedRecording
from idfslam.errors import ConfigError
from idfslam.scenes.corridor import build_corridor


class SyntheticCorridor(RenderedRecording):
    """`seed` draws building and walk; `laps` rounds, each with its own sway, or `frames` where that is more.

    `noise` adds what a Kinect does to depth and colour. Raises ConfigError for a negative seed, and for a size or laps not positive.
    """

    def __init__(self, seed: int = 0, laps: int = 1, frames: int = 0, width: int = 320, height: int = 240, noise: bool = False) -> None:
        if seed < 0 or laps < 1 or width < 8 or height < 8:
            raise ConfigError(f"corridor {seed}, {laps} laps, {width}x{height} px; expected a seed >= 0 and at least 1 lap and 8x8 px")
        self.corridor = build_corridor(seed)
        plan = self.corridor.plan
        name = f"corridor-{seed}{'-noise' if noise else ''}{f'-{laps}laps' if laps > 1 else ''}"
        poses = walk(seed, max(frames, lap_frames(plan.half, laps)), plan)
        super().__init__(name, self.corridor, poses, (width, height), seed=seed, noise=noise)
