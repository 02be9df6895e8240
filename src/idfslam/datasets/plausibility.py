"""Whether a recording's depth and stamps can be right; where they cannot, one line with the likely cause and the flag that mends it."""

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from idfslam.sensing.depth_noise import noise_ratio

MEDIAN_DEPTH = (0.25, 12.0)  # [m] of a recording's median depth; widened, fewer wrong scales are found. Depth cameras measure from about
#    0.2 m, and few reach 10 m; stereo cameras outdoors see farther
NEAR = (0.25, 1.2)  # [m] a twentieth of the depths below the first and all but a twentieth below the second: a room five times too small.
#    Raised, close-ups of things are doubted. Chosen by hand: a room of 1 to 4 m becomes 0.2 to 0.8 m.
#    Both NEAR and the next two doubt only where another common scale gives a room
ASSUMED_NEAR = 0.6  # [m] median depth below which a scale that nobody stated, or an uncommon one, is doubted; raised, close-ups too
ASSUMED_FAR = (6.0, 3.5)  # [m] median depth, and a twentieth of the depths, above which such a scale is doubted; lowered, halls are doubted
STATED_FAR = 7.5  # [m] likewise for a common scale that somebody stated; lowered, halls are doubted. Chosen by hand: halls of 6 m pass
ROOM = (0.7, 5.0)  # [m] median depth that another scale must give; widened, more scales are proposed. Chosen by hand
BEYOND = (20.0, 0.25)  # [m] reach of depth cameras indoors, [1] share of readings beyond it; raised, fewer wrong scales are found
SCALES = (1000.0, 5000.0, 6553.5, 1.0, 10000.0)  # units per metre that are common, the commonest first; more: more scales are proposed,
#    wrongly too
CLIPPED = (3, 0.02, 10.0)  # frames that end at the same depth, [1] share of a frame's readings there, [1] times as many as at the next
#    depth before it; raised, fewer sensors that clip are found. Chosen by hand: a wall that a moving camera sees ends at another depth in
#    each frame, and quantised depth has about as many readings in the steps before
STEPS = 2.0  # [1] standard deviation of what the steps of quantised depth hide, over the noise that alignments assume, above which they are
#    told; raised, coarser steps pass. A Kinect's steps have 0.45, stereo in whole pixels 3.9. Chosen by hand between them: noise of
#    three times as much harms no pose
RATE = (1.0, 300.0)  # [frames/s] of cameras; widened, fewer wrong stamps are found


def depth_doubt(depths: NDArray[np.float32], scale: float, *, assumed: bool) -> str | None:
    """What is implausible about a sample of depths (N,) [m], of images in 1/`scale` m. assumed: nobody stated the scale."""
    if not len(depths):
        return None
    near, median, far = (float(value) for value in np.percentile(depths, (5, 50, 95)))
    other = common_scale(median * scale, scale)
    unsure = assumed or scale not in SCALES
    shallow = (near < NEAR[0] and far < NEAR[1]) or (unsure and median < ASSUMED_NEAR)
    deep = near > ASSUMED_FAR[1] and median > (ASSUMED_FAR[0] if unsure else STATED_FAR)
    too_small = median < MEDIAN_DEPTH[0] or (shallow and other is not None)
    too_large = median > MEDIAN_DEPTH[1] or (deep and other is not None)
    if too_small or too_large:
        mend = f"{other:g} (a median of {median * scale / other:.2f} m)" if other else "in units per metre"
        kind = "small" if too_small else "large"
        found = f"the median depth of {median:.2f} m is implausibly {kind}: the depth scale of 1/{scale:g} m is probably wrong"
        return f"{found}; give --camera.depth-scale {mend}"
    beyond = float((depths > BEYOND[0]).mean())
    if beyond > BEYOND[1]:
        found = f"{100 * beyond:.0f} % of the depth is beyond {BEYOND[0]:.0f} m, which few depth cameras reach"
        return f"{found}: check the depth scale (--camera.depth-scale), or store 0 where there is no reading"
    return None


def clipping_doubt(frames: Sequence[NDArray[np.float32]]) -> str | None:
    """Whether depth ends at one value, where the sensor clips what is farther. frames: the readings (N,) [m] of some frames."""
    ends = [_end(depths) for depths in frames if len(depths)]
    farthest = max((depth for depth, _, _ in ends), default=0.0)
    shares = [share for depth, share, times in ends if depth == farthest and share >= CLIPPED[1] and times >= CLIPPED[2]]
    if len(shares) < CLIPPED[0]:
        return None
    reach, many = np.floor(1000 * farthest) / 1000, f"{len(shares)} of {len(ends)} frames that were looked at"
    found = f"depth ends at {farthest:.2f} m in {many}, with {100 * np.mean(shares):.0f} % of it: the sensor probably clips what is farther"
    return f"{found}; give --camera.reach {reach:g}, so that it counts as no reading"


def _end(depths: NDArray[np.float32]) -> tuple[float, float, float]:
    """The largest depth [m], the share of the readings (N,) there, and how many times as many they are as at the next depth before it."""
    values, counts = np.unique(depths, return_counts=True)
    times = counts[-1] / counts[-2] if len(counts) > 1 else 0.0  # a plane alone ends nowhere
    return float(values[-1]), float(counts[-1] / len(depths)), float(times)


def steps_doubt(frames: Sequence[NDArray[np.float32]], depth_noise: float) -> str | None:
    """Whether depth comes in coarse steps, as that of stereo in whole pixels. frames: the readings (N,) [m] of some frames.

    depth_noise [m]: that alignments assume at the sensor's best range (`sensing.depth_noise`). A step hides its length over root 12.
    """
    depths, steps = np.concatenate([np.zeros((2, 0)), *map(_steps, frames)], axis=1)
    if not len(depths):
        return None
    suits = float(np.median(steps / 12**0.5 / noise_ratio(torch.from_numpy(depths)).numpy()))
    if suits < STEPS * depth_noise:
        return None
    middle = torch.tensor(float(np.median(depths)))
    step = suits * 12**0.5 * float(noise_ratio(middle))
    found = f"depth comes in steps of {100 * step:.0f} cm at {middle:.1f} m, which hide more than the noise that is assumed"
    return f"{found}; --alignment.depth-noise {suits:.2g} suits it"


def _steps(depths: NDArray[np.float32]) -> NDArray[np.float64]:
    """(2, M) [m] the readings (N,) that are not the farthest, and how far the next larger one is from each."""
    values, which = np.unique(depths.astype(np.float64), return_inverse=True)
    kept = which[which < len(values) - 1]
    return np.stack([values[kept], np.diff(values)[kept]])


def stamps_doubt(stamps: NDArray[np.float64], source: str) -> str | None:
    """What is implausible about stamps (N,) [s] that increase."""
    if len(stamps) < 3:
        return None
    steps = np.diff(stamps)
    rate = 1 / float(np.median(steps))
    if (steps == 1).all():
        return f"the {source} are 1 s apart: they are probably frame numbers, expected seconds"
    if not RATE[0] <= rate <= RATE[1]:
        return f"the {source} mean {rate:.4g} frames/s, expected {RATE[0]:g} to {RATE[1]:g}: are they in seconds?"
    return None


def common_scale(units: float, scale: float) -> float | None:
    """Another common scale that makes a room of a median depth in units of the images; None if none does, or `scale` does as well."""
    return next((other for other in SCALES if other != scale and ROOM[0] <= units / other <= ROOM[1]), None)
