"""Views that the map was not made of: every eighth frame is kept from SLAM, and the map is rendered where that frame was taken.

Usage: python benchmarks/held_out_views.py RECORDING [FRAMES] [SEED]
A view's pose lies between the estimated poses of the frames before and after it. All pixels count; those without surface are black.
"""

import sys
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from idfslam.compute.torch_threads import limit_torch_threads
from idfslam.config import FAST
from idfslam.datasets import open_recording
from idfslam.mapping.saved_map import load_map
from idfslam.slam import Slam

_EVERY = 8  # one frame of so many is held out; more: the map sees nearly the same
_VIEWS = 30  # at most, evenly spread; more: a surer mean, slower


def main() -> None:
    """Prints the mean PSNR of the held-out views, and that of the frames before them, which the map was made of."""
    arguments = sys.argv[1:]
    frames, seed = int(arguments[1]) if len(arguments) > 1 else 10**9, int(arguments[2]) if len(arguments) > 2 else 0
    limit_torch_threads(FAST.field.encoding)
    recording = open_recording(arguments[0])
    count = min(frames, len(recording))
    held_out = list(range(_EVERY // 2, count - 1, _EVERY))
    used = sorted(set(range(count)) - set(held_out))
    slam = Slam(replace(FAST, seed=seed))
    for number, i in enumerate(used):
        slam.process(replace(recording[i], index=number))
    slam.finish()
    poses = dict(zip(used, slam.trajectory()))
    with TemporaryDirectory() as folder:
        slam.save_map(Path(folder) / "map.safetensors")
        saved = load_map(Path(folder) / "map.safetensors")
    chosen = [held_out[k] for k in np.unique(np.linspace(0, len(held_out) - 1, _VIEWS).round().astype(int))]

    def view(i: int, T_wc: NDArray[np.float64]) -> float:
        return psnr(recording[i].colour, saved.render(T_wc, recording.camera)[0])

    unseen = [view(i, between(poses[i - 1], poses[i + 1])) for i in chosen]
    seen = [view(i - 1, poses[i - 1]) for i in chosen]
    print(f"{len(chosen)} of {len(held_out)} held-out views: PSNR {np.mean(unseen):.2f} dB, worst {np.min(unseen):.2f} dB")
    print(f"the frames before them, of which the map was made: PSNR {np.mean(seen):.2f} dB")


def between(before: NDArray[np.float64], after: NDArray[np.float64]) -> NDArray[np.float64]:
    """The pose (4, 4) half way between two."""
    T = np.eye(4)
    T[:3, :3] = Slerp([0, 1], Rotation.from_matrix([before[:3, :3], after[:3, :3]]))(0.5).as_matrix()
    T[:3, 3] = (before[:3, 3] + after[:3, 3]) / 2
    return T


def psnr(colour: NDArray[np.float32], rendered: NDArray[np.float32]) -> float:
    """Peak signal-to-noise ratio [dB] of images (H, W, 3) in [0, 1]."""
    return float(-10 * np.log10(np.mean((colour - np.clip(rendered, 0, 1)) ** 2)))


if __name__ == "__main__":
    main()
