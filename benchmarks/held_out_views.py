"""Views that the map was not made of: every eighth frame is kept from SLAM, and the map is rendered where that frame was taken.

Usage: python benchmarks/held_out_views.py RECORDING [FRAMES] [SEED]
A view's pose lies between the estimated poses of the frames before and after it. All pixels count; those without surface are black.
The map has the exposure of the first keyframe. PSNR is given at the exposure of each recorded image (the gain and offset of each channel
that fit best), and of the images as they are.
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
from idfslam.sensing.matched_exposure import matched_exposure
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

    def view(i: int, T_wc: NDArray[np.float64]) -> tuple[float, float]:
        seen, (colour, depth) = recording[i].colour, saved.render(T_wc, recording.camera)[:2]
        matched = np.where(depth[..., None] > 0, matched_exposure(colour, seen, depth > 0), 0)
        return psnr(seen, matched), psnr(seen, colour)

    unseen = np.array([view(i, between(poses[i - 1], poses[i + 1])) for i in chosen])
    seen = np.array([view(i - 1, poses[i - 1]) for i in chosen])
    print(f"{len(chosen)} of {len(held_out)} held-out views, and the frames before them, of which the map was made:")
    for k, exposure in enumerate(("at the exposure of each image", "as they are")):
        means = f"PSNR {unseen[:, k].mean():.2f} dB, worst {unseen[:, k].min():.2f} dB; frames before {seen[:, k].mean():.2f} dB"
        print(f"{exposure}: {means}")


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
