"""What a recording was taken to be, in the line at the start of a run, and warnings of what is implausible about it."""

import logging
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import PurePath
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from idfslam.config import FAST
from idfslam.datasets import plausibility
from idfslam.datasets.cameras import plausibility as camera_plausibility
from idfslam.datasets.provenance import ASSUMED, GENERATED, Provenance, provenance
from idfslam.datasets.recording import depth_timestamps, timing
from idfslam.errors import FrameError
from idfslam.frame import Frame
from idfslam.geometry.camera import Camera
from idfslam.geometry.sensor_timing import SYNCHRONISED, SensorTiming

log = logging.getLogger(__name__)

_SAMPLES = 5  # frames, spread over the recording, whose depth is looked at; raised, opening takes longer, and rare views count less
_STEP = 4  # [px] between the pixels that are looked at; raised, opening is quicker


class _Recording(Protocol):
    name: str
    camera: Camera
    timestamps: NDArray[np.float64]
    ground_truth: NDArray[np.float64] | None

    def __len__(self) -> int: ...

    def __getitem__(self, i: int) -> Frame: ...


@dataclass(frozen=True, eq=False)
class InputSummary:
    """What a recording was taken to be."""

    camera: Camera
    sources: Provenance
    frames: tuple[NDArray[np.float32], ...]  # (N,) [m] each: a sample of some frames; none of generated recordings, whose depth is exact
    frames_per_second: float | None  # None: there is one frame only
    timing: SensorTiming = SYNCHRONISED
    with_truth: tuple[int, int] | None = None  # how many frames have ground truth, and of how many; None: it is unknown

    @property
    def depths(self) -> NDArray[np.float32]:
        """(N,) [m] the samples of all these frames."""
        return np.concatenate(self.frames) if self.frames else np.zeros(0, np.float32)

    @property
    def median_depth(self) -> float | None:
        """[m]"""
        return float(np.median(depths)) if len(depths := self.depths) else None

    def __str__(self) -> str:
        c, s = self.camera, self.sources
        parts = [f"camera {c.width}x{c.height} f {c.fx:.1f} {c.fy:.1f} c {c.cx:.1f} {c.cy:.1f} ({brief(s.camera)})"]
        if s.camera != GENERATED:
            unit = "in m" if s.depth_scale == 1 else f"1/{s.depth_scale:g} m"
            parts.append(f"depth {unit}{f' ({s.depth})' if s.depth else ''}")
            parts.append("no depth" if self.median_depth is None else f"median {self.median_depth:.2f} m")
        if self.frames_per_second is not None:
            parts.append(f"{self.frames_per_second:.1f} frames/s ({s.stamps})")
        if s.depth_delay:
            parts.append(f"depth {abs(1000 * s.depth_delay):.0f} ms {'after' if s.depth_delay > 0 else 'before'} colour")
        if s.camera != GENERATED:
            parts.append(shutter(self.timing))
        if s.camera != GENERATED and self.with_truth is not None and self.with_truth[0] < self.with_truth[1]:
            parts.append("ground truth for {} of {} frames".format(*self.with_truth))
        return ", ".join(parts)

    def to_dict(self) -> dict[str, Any]:
        """For metrics.json."""
        return {
            "camera_source": brief(self.sources.camera),
            "depth_scale": self.sources.depth_scale,
            "depth_scale_source": self.sources.depth or "stated",
            "median_depth_m": self.median_depth,
            "stamps_per_second": self.frames_per_second,
            "stamps_source": self.sources.stamps,
            "readout_s": self.timing.readout,
            "depth_readout_s": self.timing.depth_readout,
            "depth_delay_s": self.timing.depth_delay,
        }


def summarise(recording: _Recording) -> InputSummary | None:
    """Reads a few frames of a recording; None for one that does not know where its values come from."""
    sources = provenance(recording)
    if sources is None:
        return None
    steps = np.diff(recording.timestamps)
    rate = 1 / float(np.median(steps)) if len(steps) and np.median(steps) > 0 else None
    frames = () if sources.camera == GENERATED else tuple(_depths(recording))
    truth = recording.ground_truth
    with_truth = None if truth is None else (int(np.isfinite(truth).all((1, 2)).sum()), len(truth))
    return InputSummary(recording.camera, sources, frames, rate, timing(recording), with_truth)


def shutter(times: SensorTiming) -> str:
    """What is known about a sensor's times, in a few words."""
    colour, depth = (
        "unknown shutter" if readout is None else f"read-out of {1000 * readout:.0f} ms" if readout else "global shutter"
        for readout in (times.readout, times.depth_readout)
    )
    text = colour if colour == depth else f"colour {colour}, depth {depth}"
    delay = times.depth_delay or 0.0
    return f"{text}, depth {abs(1000 * delay):.0f} ms {'after' if delay > 0 else 'before'} its stamps" if delay else text


def doubts(summary: InputSummary, stamps: NDArray[np.float64]) -> Iterator[str]:
    """What is implausible, one line each with the likely cause and the flag that mends it. stamps: (N,) [s] of all frames."""
    sources = summary.sources
    if sources.camera == GENERATED:
        return
    yield from camera_plausibility.doubts(summary.camera, brief(sources.camera))
    if sources.distortion and (doubt := camera_plausibility.lens_doubt(summary.camera, sources.distortion, brief(sources.camera))):
        yield doubt
    if doubt := plausibility.depth_doubt(summary.depths, sources.depth_scale, assumed=bool(sources.depth)):
        yield doubt
    if doubt := plausibility.clipping_doubt(summary.frames):
        yield doubt
    if doubt := plausibility.steps_doubt(summary.frames, FAST.alignment.depth_noise):
        yield doubt
    if sources.stamps != ASSUMED and (doubt := plausibility.stamps_doubt(stamps, sources.stamps)):
        yield doubt


def report(recording: _Recording, stamps: NDArray[np.float64]) -> None:
    """Logs the line about a recording, and a warning of each thing that is implausible. stamps: as in `doubts`."""
    if (summary := summarise(recording)) is not None:
        log.info("%s", summary)
        for doubt in (*summary.sources.notes, *doubts(summary, stamps)):
            log.warning("%s: %s", recording.name, doubt)


def brief(source: str) -> str:
    """A source without the folders of a file's path: `intrinsics.txt`, `kitchen.bag: /camera/camera_info`."""
    path, colon, rest = source.removeprefix("the ").partition(": ")
    head, space, tail = path.partition(" with ")
    return f"{PurePath(head).name}{space}{tail}{colon}{rest}"


def _depths(recording: _Recording) -> Iterator[NDArray[np.float32]]:
    """Readings of a few frames; of those that can be read."""
    spread = getattr(recording, "random_access", True)
    stamps = depth_timestamps(recording)
    with_depth = np.flatnonzero(np.isfinite(recording.timestamps if stamps is None else stamps))  # frames that have a depth image
    count = len(with_depth)
    chosen = np.linspace(0, count - 1, _SAMPLES).astype(int) if spread and count else np.arange(min(_SAMPLES, count))
    for i in with_depth[np.unique(chosen)].tolist():
        try:
            depth = recording[i].depth[::_STEP, ::_STEP]
        except FrameError:
            continue
        yield depth[depth > 0]
