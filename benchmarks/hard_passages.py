"""Passages that are hard to track, each alone in a recording of a generated room: which poses are wrong, and does the system say so?

    python benchmarks/hard_passages.py [PASSAGE ...] [--rooms 3 ...] [--faults NAME] [--seed 0] [--list]

Without PASSAGE it runs all; --list names them. A room has a Kinect's noise and 320x240 pixels; --faults has the recording held by hand,
with the faults of a real sensor, such as `shutter+time`. It prints a row of a table in Markdown for each passage:

- ATE RMSE at the end of the run: of the frames that are neither doubtful nor lost then, and of all [cm].
- How many frames were lost, doubtful and degenerate when they were processed.
- Of the frames that were off then, how many were called good, and of the others how many were called bad (`idfslam.evaluation.doubt`).
"""

import argparse
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from idfslam.compute.process import prepare_process

prepare_process()

import torch  # noqa: E402
from numpy.typing import NDArray  # noqa: E402

from idfslam.config import FAST  # noqa: E402
from idfslam.datasets.generated.faults import Faults  # noqa: E402
from idfslam.datasets.generated.handheld import HandheldRecording, handheld_room  # noqa: E402
from idfslam.datasets.generated.handheld_motion import Walk  # noqa: E402
from idfslam.datasets.generated.rendered import FPS, RenderedRecording, poses_looking  # noqa: E402
from idfslam.datasets.generated.room import BARE_PASSAGE, SyntheticRoom, tour_at  # noqa: E402
from idfslam.evaluation.doubt import ReportedFrames, doubt_rates  # noqa: E402
from idfslam.evaluation.trajectory_error import absolute_trajectory_error  # noqa: E402
from idfslam.frame import Frame, Status  # noqa: E402
from idfslam.scenes.room import build_room  # noqa: E402
from idfslam.slam import Slam  # noqa: E402

Array = NDArray[np.float64]
Recording = SyntheticRoom | HandheldRecording | RenderedRecording
Change = Callable[["Passage", int, Frame], Frame]
WIDTH, HEIGHT = 320, 240  # [px]
FRAMES = 200  # of a passage
LO = 80  # the frame at which most changes begin
COVERED = -1  # stands for a frame of a covered lens in an order of frames, where others are numbers from 0


class Passage:
    """The frames of a recording in an order of their own, each changed; `len`, `[i]`, `ground_truth` (N, 4, 4), NaN where covered."""

    def __init__(self, recording: Recording, order: Sequence[int], change: Change, stamps: Array) -> None:
        self.recording, self.order, self._change, self._stamps = recording, order, change, stamps
        truth = np.asarray(recording.ground_truth)
        self.ground_truth = np.stack([np.full((4, 4), np.nan) if of == COVERED else truth[of] for of in order])
        self._kept: dict[int, Frame] = {}

    def __len__(self) -> int:
        return len(self.order)

    def taken(self, of: int) -> Frame:
        """A frame as it was recorded, rendered once."""
        if of not in self._kept:
            self._kept[of] = self.recording[of]
        return self._kept[of]

    def __getitem__(self, i: int) -> Frame:
        of, stamp = self.order[i], float(self._stamps[i])
        frame = covered(self.recording, i) if of == COVERED else self.taken(of)
        return self._change(self, i, replace(frame, index=i, timestamp=stamp, depth_timestamp=stamp + frame.depth_lag))

    def points(self, i: int) -> Array:
        """(H, W, 3) [m] the points that frame i shows, in the world."""
        frame, camera, T = self.taken(self.order[i]), self.recording.camera, self.ground_truth[i]
        v, u = np.mgrid[: camera.height, : camera.width]
        rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], -1)
        return np.asarray((rays * frame.depth[..., None]) @ T[:3, :3].T + T[:3, 3])

    def seen_by(self, i: int, by: int) -> Array:
        """(H, W, 3) [m] the points that frame i shows, in the axes of frame `by`."""
        T = self.ground_truth[by]
        return np.asarray((self.points(i) - T[:3, 3]) @ T[:3, :3])


def covered(recording: Recording, i: int) -> Frame:
    """What a covered lens shows: a faint glow, noise, and no depth."""
    glow = np.linspace(0.03, 0.12, HEIGHT)[:, None, None] * np.array([1, 0.6, 0.5]) * np.ones((HEIGHT, WIDTH, 1))
    noise = 0.012 * np.random.default_rng([7, i]).standard_normal((HEIGHT, WIDTH, 3))
    return Frame(i, 0.0, eight_bits(glow + noise), np.zeros((HEIGHT, WIDTH), np.float32), recording.camera)


def eight_bits(colour: NDArray[np.floating]) -> NDArray[np.float32]:
    """A colour image as a camera's 8 bits have it."""
    return (np.rint(np.clip(colour, 0, 1) * 255) / 255).astype(np.float32)


def lit(frame: Frame, gain: float | Array) -> Frame:
    """The frame in this share of the light."""
    return replace(frame, colour=eight_bits(frame.colour * gain))


def black(frame: Frame) -> Frame:
    """The frame with a black image."""
    return replace(frame, colour=eight_bits(np.random.default_rng(frame.index).normal(0.01, 0.005, frame.colour.shape)))


def without_depth(frame: Frame, where: NDArray[np.bool_] | bool = True) -> Frame:
    """The frame without the readings at these pixels (H, W); True: without any."""
    return replace(frame, depth=np.where(where, 0, frame.depth).astype(np.float32))


# Changes of light


def lamp(gains: tuple[float, float], passage: Passage, i: int, frame: Frame) -> Frame:
    """A lamp is switched: the shares of the light before and after frame LO."""
    return lit(frame, gains[i >= LO])


def flashes(passage: Passage, i: int, frame: Frame) -> Frame:
    """2.5 times the light in every tenth frame."""
    return lit(frame, 2.5) if i >= LO and i % 10 == 0 else frame


def exposure_steps(passage: Passage, i: int, frame: Frame) -> Frame:
    """The exposure changes by 30 to 43 % every 20 frames."""
    rng, gain = np.random.default_rng(5), 1.0
    for _ in range(20, i + 1, 20):
        gain = float(np.clip(gain * rng.choice([0.7, 1.3, 0.77, 1.43]), 0.35, 1.2))
    return lit(frame, gain)


def half_dark(passage: Passage, i: int, frame: Frame) -> Frame:
    """The light of half the room falls to 0.4, with an edge 0.3 m wide."""
    if i < LO:
        return frame
    return lit(frame, (0.4 + 0.6 / (1 + np.exp(-passage.seen_by(i, LO)[..., 0] / 0.3)))[..., None])


def starts_dark(passage: Passage, i: int, frame: Frame) -> Frame:
    """The first 16 frames are nearly dark."""
    return lit(frame, min(1.0, 0.04 + 0.06 * i))


def flicker(passage: Passage, i: int, frame: Frame) -> Frame:
    """A lamp at 50 Hz and a shutter of 20 ms: bands of 0.7 to 1.3 of the light, which wander over the rows."""
    rows = np.arange(HEIGHT) / HEIGHT * 0.020 + i / FPS
    return lit(frame, (1 + 0.3 * np.sin(2 * np.pi * 100 * rows))[:, None, None])


# Images that fail


def shown(images: Callable[[Frame], Frame], frames: int, passage: Passage, i: int, frame: Frame) -> Frame:
    """From frame LO on, for some frames, what `images` makes of them."""
    return images(frame) if LO <= i < LO + frames else frame


def white(frame: Frame) -> Frame:
    """An image with six times the light."""
    return replace(frame, colour=eight_bits(frame.colour * 6 + 0.4))


def held(which: str, frames: int, passage: Passage, i: int, frame: Frame) -> Frame:
    """One of the two images stays that of frame LO."""
    return replace(frame, **{which: getattr(passage.taken(passage.order[LO]), which)}) if LO <= i < LO + frames else frame


def striped(passage: Passage, i: int, frame: Frame) -> Frame:
    """Stripes of the world have no depth."""
    points = passage.points(i)
    return without_depth(frame, np.abs(np.sin(points[..., 0] * 1.5 + points[..., 1] * 1.1)) < 0.35)


def window(passage: Passage, i: int, frame: Frame) -> Frame:
    """40 % of the columns have no depth."""
    columns = np.arange(WIDTH)
    return without_depth(frame, np.broadcast_to((columns >= 100) & (columns < 230), frame.depth.shape))


def short_range(reach: float, passage: Passage, i: int, frame: Frame) -> Frame:
    """No depth beyond `reach` [m]."""
    return without_depth(frame, frame.depth > reach)


def covered_start(passage: Passage, i: int, frame: Frame) -> Frame:
    """The lens is covered for 60 frames, and depth sees a strip."""
    strip = np.arange(HEIGHT)[:, None] >= 0.95 * HEIGHT
    return without_depth(black(frame), ~strip & np.ones_like(frame.depth, bool)) if i < 60 else frame


def film(passage: Passage, i: int, frame: Frame) -> Frame:
    """A screen shows a film: squares of changing colours, in a place of the world that frame 60 shows."""
    at = passage.seen_by(i, 60)
    z = np.maximum(at[..., 2], 0.1)
    x, y = at[..., 0] / z, at[..., 1] / z
    on_screen = (np.abs(x) < 0.45) & (np.abs(y) < 0.3) & (at[..., 2] > 0.3) & (frame.depth > 0)
    picture = np.random.default_rng(i // 3).random((10, 14, 3))
    columns, rows = (np.clip(((c + h) / (2 * h) * n).astype(int), 0, n - 1) for c, h, n in ((x, 0.45, 14), (y, 0.3, 10)))
    return replace(frame, colour=eight_bits(np.where(on_screen[..., None], picture[rows, columns], frame.colour)))


def gripper(passage: Passage, i: int, frame: Frame) -> Frame:
    """A gripper that the camera carries along, 45 to 57 cm away, fills a fifth of the image from the first frame on."""
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    off = ((u - 205) / 95) ** 2 + ((v - 245) / 110) ** 2
    pattern, rng = 0.45 + 0.25 * np.sin(u / 5 + 2 * np.sin(v / 9)) * np.cos(v / 6), np.random.default_rng([9, i])
    skin = pattern[..., None] * np.array([0.9, 0.65, 0.5]) + 0.012 * rng.standard_normal((HEIGHT, WIDTH, 3))
    depth = np.where(off < 1, 0.45 + 0.12 * off + 0.0015 * rng.standard_normal(off.shape), frame.depth)
    return replace(frame, colour=eight_bits(np.where((off < 1)[..., None], skin, frame.colour)), depth=depth.astype(np.float32))


def unchanged(passage: Passage, i: int, frame: Frame) -> Frame:
    """The frame as it is."""
    return frame


# Passages of a recording: a change of its frames, or an order of them


@dataclass(frozen=True)
class Room:
    """A generated room, and how it is recorded: with a Kinect's noise, or by hand with these faults."""

    number: int
    faults: str | None

    def recorded(self, frames: int) -> Recording:
        """A walk of some frames."""
        if self.faults is None:
            return SyntheticRoom(self.number, frames, WIDTH, HEIGHT, noise=True)
        return handheld_room(Faults.named(self.faults), self.number, frames, WIDTH, HEIGHT)

    def seen_from(self, poses: Array, *, bare_wall: bool = False) -> Recording:
        """The room from poses (N, 4, 4), with a Kinect's noise."""
        scene = build_room(self.number, bare_wall=bare_wall)
        return RenderedRecording("passage", scene, poses, (WIDTH, HEIGHT), seed=self.number, noise=True)

    def walked(self, walk: Walk, frames: int) -> Recording:
        """The room from a camera that is carried along a walk."""
        if self.faults is None:
            return self.seen_from(walk(np.arange(frames) / FPS))
        scene, size = build_room(self.number), (WIDTH, HEIGHT)
        return HandheldRecording("passage", scene, walk, size, seed=self.number, frames=frames, faults=Faults.named(self.faults))


def changed(change: Change, room: Room) -> Passage:
    """A walk with changed frames."""
    recording = room.recorded(FRAMES)
    return Passage(recording, range(FRAMES), change, recording.timestamps)


def ordered(order: Sequence[int], room: Room) -> Passage:
    """Frames of a walk in this order, at 30 Hz."""
    return Passage(room.recorded(max(order) + 1), order, unchanged, np.arange(len(order)) / FPS)


def with_gaps(kept: Callable[[int], bool], frames: int, room: Room) -> Passage:
    """A walk of which some frames were not recorded."""
    recording = room.recorded(frames)
    order = [i for i in range(frames) if kept(i)]
    return Passage(recording, order, unchanged, recording.timestamps[order])


def stamps_back(room: Room) -> Passage:
    """The stamps jump back by 2 s at frame 100."""
    recording = room.recorded(FRAMES)
    return Passage(recording, range(FRAMES), unchanged, recording.timestamps - 2.0 * (np.arange(FRAMES) >= 100))


def turning(degrees: float, room: Room) -> Passage:
    """The camera only turns, by some degrees a frame."""
    angles = np.deg2rad(degrees * np.arange(FRAMES))
    poses = poses_looking(np.tile([0.1, -0.1, 1.4], (FRAMES, 1)), angles, np.deg2rad(-12 + 8 * np.sin(np.arange(FRAMES) / 30)), 0 * angles)
    return Passage(room.seen_from(poses), range(FRAMES), unchanged, np.arange(FRAMES) / FPS)


def still_before_a_wall(room: Room) -> Passage:
    """The camera stands for 60 frames where a plain wall fills its view."""
    middle = sum(BARE_PASSAGE) // 2
    times = np.concatenate([np.arange(middle + 0.0), np.full(60, middle + 0.0), np.arange(middle + 1.0, middle + 120.0)])
    poses = tour_at(times, room.number, build_room(room.number, bare_wall=True).half, bare_wall=True)
    return Passage(room.seen_from(poses, bare_wall=True), range(len(poses)), unchanged, np.arange(len(poses)) / FPS)


def over_the_floor(seconds: Array) -> Array:
    """Poses (N, 4, 4) of a camera that looks down at the floor from 1.4 m, at times (N,), and turns by 18 degrees a second."""
    frame = np.asarray(seconds) * FPS
    along = 2 * np.pi * frame * 0.0012
    position = np.stack([0.9 * np.cos(along), 0.7 * np.sin(along), 1.4 + 0.05 * np.sin(frame / 20)], -1)
    angles = 0.6 * frame, -70 + 5 * np.sin(frame / 17), 3 * np.sin(frame / 23)
    return poses_looking(position, *(np.deg2rad(angle) for angle in angles))


def black_over_a_floor(room: Room) -> Passage:
    """Images are black for 50 frames, and depth shows a bare floor."""
    recording = room.walked(over_the_floor, FRAMES)
    return Passage(recording, range(FRAMES), partial(shown, black, 50), recording.timestamps)


_DARK = [COVERED] * 20
PASSAGES: dict[str, Callable[[Room], Passage]] = {
    "plain": partial(changed, unchanged),
    "lamp-off": partial(changed, partial(lamp, (1.0, 0.35))),
    "lamp-on": partial(changed, partial(lamp, (0.4, 1.0))),
    "dim": partial(changed, partial(lamp, (0.4, 0.4))),
    "flashes": partial(changed, flashes),
    "exposure-steps": partial(changed, exposure_steps),
    "half-dark": partial(changed, half_dark),
    "starts-dark": partial(changed, starts_dark),
    "flicker": partial(changed, flicker),
    "film": partial(changed, film),
    "gripper": partial(changed, gripper),
    "no-depth": partial(changed, partial(shown, without_depth, 30)),
    "white": partial(changed, partial(shown, white, 15)),
    "black": partial(changed, partial(shown, black, 30)),
    "black-over-a-floor": black_over_a_floor,
    "lens-covered": partial(changed, partial(shown, lambda frame: without_depth(black(frame)), 30)),
    "covered-start": partial(changed, covered_start),
    "depth-held": partial(changed, partial(held, "depth", 14)),
    "colour-held": partial(changed, partial(held, "colour", 14)),
    "depth-stripes": partial(changed, striped),
    "depth-window": partial(changed, window),
    "reach-2.1": partial(changed, partial(short_range, 2.1)),
    "reach-1.6": partial(changed, partial(short_range, 1.6)),
    "every-fourth-repeated": partial(ordered, [i - (i % 4 == 3) for i in range(FRAMES)]),
    "every-fifth": partial(with_gaps, lambda i: i % 5 == 0, 5 * 100),
    "ten-dropped": partial(with_gaps, lambda i: not 100 <= i < 110, FRAMES),
    "stamps-back": stamps_back,
    "carried-to-known": partial(ordered, [*range(200), *_DARK, *range(60, 140)]),
    "carried-to-unknown": partial(ordered, [*range(150), *_DARK, *range(400, 520)]),
    "carried-and-back": partial(ordered, [*range(150), *_DARK, *range(430, 620)]),
    "turning": partial(turning, 1.2),
    "turning-fast": partial(turning, 3.6),
    "still-before-a-wall": still_before_a_wall,
}


def row(name: str, room: Room, seed: int) -> str:
    """Runs a passage: a row of the table."""
    passage, slam = PASSAGES[name](room), Slam(replace(FAST, seed=seed))
    results = [replace(slam.process(passage[i]), moving=None) for i in range(len(passage))]
    slam.finish()
    truth, found = passage.ground_truth, slam.trajectory()
    rates = doubt_rates(ReportedFrames.of(results, corrected={max(pair) for pair in slam.figures()["loops"]}), truth)
    trusted, known = np.array([status.trusted for status in slam.statuses()]), np.isfinite(truth).all((1, 2))
    errors = [f"{100 * absolute_trajectory_error(found[of], truth[of]).translation.rmse:.2f}" for of in (known & trusted, known)]
    live = Counter(result.status for result in results)
    statuses = ", ".join(str(live[status]) for status in (Status.LOST, Status.DOUBTFUL, Status.DEGENERATE))
    doubt = f"{rates.missed} of {rates.off} | {rates.false_alarms} of {rates.good}"
    return f"| {name} | {room.number} | {len(passage)} | {' | '.join(errors)} | {statuses} | {doubt} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("passages", nargs="*", metavar="PASSAGE", help="names; default: all")
    parser.add_argument("--rooms", nargs="+", type=int, default=[3], help="numbers of generated rooms")
    parser.add_argument("--faults", help="held by hand, with these faults, such as shutter+time")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--list", action="store_true", help="names the passages")
    arguments = parser.parse_args()
    if unknown := set(arguments.passages) - set(PASSAGES):
        parser.error(f"unknown passage {', '.join(sorted(unknown))}; expected some of {', '.join(PASSAGES)}")
    if arguments.list:
        print(*PASSAGES, sep="\n")
        return
    torch.set_num_threads(1)
    print("| passage | room | frames | ATE of trusted [cm] | of all | lost, doubtful, degenerate | off, called good | right, called bad |")
    print("|---|---:|---:|---:|---:|---|---|---|", flush=True)
    for name in arguments.passages or PASSAGES:
        for number in arguments.rooms:
            print(row(name, Room(number, arguments.faults), arguments.seed), flush=True)


if __name__ == "__main__":
    main()
