"""Doubt: fits the model of `idfslam.alignment.pose_doubt` to right and wrong poses of recordings with ground truth.

    python benchmarks/fit_doubt.py RECORDING ... [--held-out RECORDING ...] [--frames N] [--every N] [--stride N]

At every so many frames the alignment is started at wrong guesses too, 2 to 20 degrees and 2 to 30 cm off. Some end at the right pose, and
some in a wrong place. Each pose is right or wrong (off by more than 5 cm or 2 degrees against the last good frame), and has a displacement
over the usual one. A logistic model of the logarithm of that ratio is fitted, right and wrong poses counting alike. It prints the
coefficients, and for recordings that took part in the fit and for others which shares of poses lie on the wrong side of the threshold.
"""

import argparse
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from idfslam.compute.process import prepare_process

prepare_process()

import torch  # noqa: E402
from scipy.optimize import minimize  # noqa: E402

from idfslam.alignment import pose_doubt  # noqa: E402
from idfslam.alignment.motion import moved  # noqa: E402
from idfslam.config import FAST  # noqa: E402
from idfslam.datasets import open_recording  # noqa: E402
from idfslam.evaluation.doubt import OFF_SHIFT, OFF_TURN  # noqa: E402
from idfslam.evaluation.trajectory_error import errors_of_motion  # noqa: E402
from idfslam.frame import Status  # noqa: E402
from idfslam.runs.source import read_frames  # noqa: E402
from idfslam.slam import Slam, Tracked  # noqa: E402
from idfslam.slam.front_end.alignment_to_map import AlignmentToMap  # noqa: E402

_GUESSES = 3  # wrong guesses at a frame. More: more wrong poses in the same time. Chosen by hand
_SIZES = 2.0, 20.0  # [degrees] range of the guesses' errors of turn; about as many centimetres of shift. Chosen by hand


@dataclass(frozen=True)
class Poses:
    """Poses of one recording."""

    ratio: NDArray[np.float64]  # (N,) displacement over the usual one
    error: NDArray[np.float64]  # (N,) the larger of shift over 5 cm and turn over 2 degrees: above 1 the pose is wrong
    provoked: NDArray[np.bool_]  # (N,) whether the alignment was started at a wrong guess


def poses_of(name: str, frames: int | None, every: int, stride: int) -> Poses:
    """The poses of a run, with those that were provoked. They do not influence the run."""
    recording, slam = open_recording(name, frames=frames, stride=stride), Slam(FAST)
    assert isinstance(slam.front_end, AlignmentToMap) and recording.ground_truth is not None
    front_end, truth, rng = slam.front_end, np.asarray(recording.ground_truth), np.random.default_rng(0)
    aligner, found = front_end.aligner, list[tuple[float, float, bool]]()
    last: tuple[int, NDArray[np.float64]] | None = None  # number and pose of the last good frame

    def judged(index: int, T_wc: torch.Tensor, displacement: float, *, provoked: bool) -> float:
        assert last is not None
        shift, turn = errors_of_motion(last[1][None], T_wc.numpy()[None], truth[[last[0]]], truth[[index]])
        error = max(float(shift[0]) / OFF_SHIFT, float(turn[0]) / OFF_TURN)
        if displacement > 0 and aligner.doubt.has_usual:
            found.append((aligner.doubt.ratio(displacement), error, provoked))
        return error

    def track(view, wrapped=front_end.track) -> Tracked:  # type: ignore[no-untyped-def]
        nonlocal last
        tracked: Tracked = wrapped(view)
        if tracked.alignment is None or not np.isfinite(truth[view.index]).all():
            return tracked
        error = 0.0 if last is None else judged(view.index, tracked.T_wc, tracked.alignment.displacement, provoked=False)
        if last is not None and view.index % every == 0 and error <= 1:
            state, prior = aligner.generator.get_state(), front_end.compensation._prior
            for n in range(_GUESSES):
                size, axes = np.exp(rng.uniform(*np.log(_SIZES))), rng.normal(size=(2, 3))
                shift, turn = (axis / np.linalg.norm(axis) for axis in axes)
                change = torch.from_numpy(np.concatenate([shift * size / 100 * rng.uniform(0.3, 1.5), turn * np.deg2rad(size)]))
                bound = aligner.expected if n == 0 else None
                wrong = aligner.align(
                    view, moved(tracked.T_wc, change), front_end.search.references(), max_guess_error_px=bound, motion=prior
                )
                if wrong.status is not Status.LOST:
                    judged(view.index, wrong.T_wc, wrong.displacement, provoked=True)
            aligner.generator.set_state(state)
        if error <= 1:
            last = view.index, tracked.T_wc.numpy().copy()
        return tracked

    front_end.track = track  # type: ignore[method-assign]
    for frame, _ in read_frames(recording):
        slam.process(frame)
    ratio, error, provoked = zip(*found)
    return Poses(np.array(ratio), np.array(error), np.array(provoked))


def fitted(poses: Poses) -> tuple[float, float]:
    """Slope and offset of the logistic model; right and wrong poses have the same total weight."""
    x, wrong = np.log(poses.ratio), poses.error > 1
    weight = np.where(wrong, 0.5 / max(wrong.sum(), 1), 0.5 / max((~wrong).sum(), 1))

    def loss(b: NDArray[np.float64]) -> float:
        z = b[0] * x + b[1]
        return float((weight * (np.logaddexp(0, z) - wrong * z)).sum()) + 1e-5 * float(b @ b)  # finite where a ratio parts all poses

    slope, offset = minimize(loss, np.array([1.0, 0.0]), method="Nelder-Mead").x
    return float(slope), float(offset)


def shares(poses: Poses, largest: float) -> str:
    """A row: which shares of poses lie on the wrong side of a ratio."""
    wrong, far, run = poses.error > 1, poses.error > 2, (poses.error <= 1) & ~poses.provoked
    told = [f"{100 * (poses.ratio[wrong] <= largest).mean():.1f} of {wrong.sum()}" if wrong.any() else "-"]
    told += [f"{100 * (poses.ratio[far] <= largest).mean():.1f} of {far.sum()}" if far.any() else "-"]
    told += [f"{100 * (poses.ratio[run] > largest).mean():.1f} of {run.sum()}"]
    return " | ".join(told)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recordings", nargs="+", help="recordings that the model is fitted to")
    parser.add_argument("--held-out", nargs="*", default=[], help="recordings that the fitted model is only tried on")
    parser.add_argument("--frames", type=int, default=200)
    parser.add_argument("--every", type=int, default=3, help="frames from one with wrong guesses to the next")
    parser.add_argument("--stride", type=int, default=1)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    names = [*arguments.recordings, *arguments.held_out]
    found = {name: poses_of(name, arguments.frames, arguments.every, arguments.stride) for name in names}
    train = [found[name] for name in arguments.recordings]
    slope, offset = fitted(Poses(*(np.concatenate([getattr(p, f) for p in train]) for f in ("ratio", "error", "provoked"))))
    largest = pose_doubt.doubtful_ratio()
    print(f"slope {slope:.2f}, offset {offset:.2f}; a ratio above {largest:.2f} is doubtful\n")
    print("| recording | wrong, not doubted [%] | twice as wrong, not doubted [%] | right in the run, doubted [%] |\n|---|---:|---:|---:|")
    for name in names:
        print(f"| {name}{' (held out)' * (name in arguments.held_out)} | {shares(found[name], largest)} |")


if __name__ == "__main__":
    main()
