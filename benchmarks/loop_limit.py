"""How much of the error a loop can take away at best: walks round a corridor with noise that is known, and exact loops.

    python benchmarks/loop_limit.py corridor:0:kinect [WALKS]

The chain of keyframes drifts by independent noise of each link, of its place or of its direction. At the end the camera sees the first
metres again; there the loops measure without any error, and the pose graph knows the noise. What is left is what no SLAM can know.
"""

import argparse

import numpy as np

from idfslam.compute.process import prepare_process

prepare_process()

import torch  # noqa: E402
from torch import Tensor  # noqa: E402

from idfslam.datasets import open_recording  # noqa: E402
from idfslam.evaluation.trajectory_error import absolute_trajectory_error  # noqa: E402
from idfslam.geometry import se3  # noqa: E402
from idfslam.graph.pose_graph import Edge, optimise  # noqa: E402

EVERY = 16  # frames from one keyframe to the next
AGAIN = 0.5  # [m] two keyframes are apart that see the same
EXACT = 1e-4  # [m], [rad] of a loop
NOISES = {"place alone": (1e-3, 1e-6), "1 mm and 0.3 mrad": (1e-3, 3e-4), "direction alone": (1e-6, 1e-3)}  # of a link [m], [rad]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording", help="with ground truth")
    parser.add_argument("walks", type=int, nargs="?", default=50, help="with noise of their own")
    arguments = parser.parse_args()
    name, walks = arguments.recording, arguments.walks
    truth = torch.from_numpy(np.asarray(open_recording(name).ground_truth)[::EVERY])
    loops = seen_again(truth)
    print(f"{name}: {len(truth)} keyframes, {len(loops)} loops; ATE with loops over ATE without, of {walks} walks: mean, 10 %, 90 %")
    for what, noise in NOISES.items():
        ratios = np.array([with_loops_over_without(truth, loops, noise, seed) for seed in range(walks)])
        mean, low, high = 100 * float(ratios.mean()), 100 * float(np.quantile(ratios, 0.1)), 100 * float(np.quantile(ratios, 0.9))
        print(f"{what}: {mean:.0f} %, {low:.0f} %, {high:.0f} %", flush=True)


def seen_again(truth: Tensor) -> list[tuple[int, int]]:
    """Keyframes of the first quarter, each with the one of the last quarter that is nearest to it, where that is near enough."""
    quarter, centres = len(truth) // 4, truth[:, :3, 3]
    apart = torch.cdist(centres[:quarter], centres[-quarter:])
    return [(a, len(truth) - quarter + int(row.argmin())) for a, row in enumerate(apart) if float(row.min()) < AGAIN]


def with_loops_over_without(truth: Tensor, loops: list[tuple[int, int]], noise: tuple[float, float], seed: int) -> float:
    """Of one walk whose links have that noise [m], [rad]."""
    generator = torch.Generator().manual_seed(seed)
    sigma = torch.tensor([noise[0]] * 3 + [noise[1]] * 3, dtype=truth.dtype)
    steps = se3.inverse(truth[:-1]) @ truth[1:]
    measured = steps @ se3.exp(sigma * torch.randn(len(steps), 6, generator=generator, dtype=truth.dtype))
    chain = [truth[0]]
    for step in measured:
        chain.append(chain[-1] @ step)
    edges = [Edge(i, i + 1, step, *noise) for i, step in enumerate(measured)]
    edges += [Edge(a, b, se3.inverse(truth[a]) @ truth[b], EXACT, EXACT) for a, b in loops]
    corrected, _ = optimise(chain, edges)
    return ate(corrected, truth) / ate(chain, truth)


def ate(poses: list[Tensor], truth: Tensor) -> float:
    return absolute_trajectory_error(torch.stack(poses).numpy(), truth.numpy()).translation.rmse


if __name__ == "__main__":
    main()
