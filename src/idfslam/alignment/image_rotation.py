"""The turn of the camera since the last frame, from small blurred images.

A shaking hand turns the camera by degrees between two frames, and no motion model foresees that. Small images show the turn at once: noise,
blur and fine texture are gone there, and a turn of two degrees moves them by a pixel (Klein and Murray, "Improving the agility of
keyframe-based SLAM", ECCV 2008). The alignment starts nearer to the pose, so it takes fewer steps and finds fewer wrong minima.
"""

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from idfslam.alignment.gauss_newton import INDEPENDENT
from idfslam.alignment.landmarks import Landmarks
from idfslam.alignment.motion import moved
from idfslam.alignment.photometric import Term, photometric_term
from idfslam.alignment.sighting import Appearance, Sighting
from idfslam.alignment.small_image import pixels_of, small_image
from idfslam.compute.backend import pick
from idfslam.storage.state import State, Stateful

# All of these were chosen by hand on generated hand-held recordings; redkitchen and fr1/rpy confirm them.
_STEPS = 6  # Gauss-Newton steps a level. More: turns of more than five degrees are found more often, slower
_CONVERGED = 1e-3  # [rad] A step below this is the last of its level: a twentieth of a pixel. More: faster, and less exact
_TURN = 0.1  # [rad] Standard deviation of an unforeseen turn. More: images with little texture turn the prediction more
_LEAST_SEEN = 100  # [pixels] A turn is estimated from at least so many that both images show. More: more predictions are kept
# [1] Least scale of brightness differences, and width of the robust kernel in scales, as in the alignment. More: outliers count more.
_NOISE, _ROBUST = 0.01, 3.0
# [1] Differences of brightness at the predicted pose, with the light of bands and parts of the image taken out over those with one gain for
# the image, below which light has changed unevenly. More: the turn is estimated together with the light more often, which is slower. Chosen
# by hand
_UNEVEN = 0.5


class ImageRotation(Stateful):
    """Corrects predicted poses by the turn that the image shows since the last frame."""

    def __init__(self) -> None:
        self._last: Landmarks | None = None  # the pixels of the last frame that has a pose and an image of its own
        self._small: Appearance | None = None  # of the present frame
        self.index = -1
        """The number of that frame; -1: there is none."""

    def state(self) -> State:
        """The pixels of the last frame, and its number."""
        return {"last": None if self._last is None else [self._last.points, *self._last.luminance], "index": self.index}

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        self._last = None if state["last"] is None else Landmarks(state["last"][0], state["last"][1:], [])
        self.index = state["index"]

    def correct(self, frame: Appearance, T_predicted: Tensor, T_last: Tensor) -> Tensor:
        """The predicted pose of a frame, turned; its shift is kept. T_last: the pose of frame `index`. All (4, 4) float64.

        The prediction is kept if the images do not agree better at the turned pose.
        """
        self._small = small_image(frame)
        return T_predicted if self._last is None else turned(self._small, self._last, T_predicted, T_last)

    def accept(self, index: int, *, lost: bool) -> None:
        """The present frame, of this number, becomes the last one, if it was corrected: otherwise it has no image of its own.

        lost: it has no pose, so that the next frame is compared with none.
        """
        if lost:
            self._last, self.index = None, -1
        elif self._small is not None:
            self._last, self.index = pixels_of(self._small), index
        self._small = None


def turned(small: Appearance, seen: Landmarks, T_wc: Tensor, T_seen: Tensor) -> Tensor:
    """A small image's pose, turned as the pixels `seen` by another view at `T_seen` show; its shift is kept. All (4, 4) float64.

    It is kept as a whole if the images do not agree better at the turned pose. Where light has changed unevenly, it is estimated with the
    turn: the bands of a lamp that flickers wander over the rows, and look like a turn up or down.
    """
    evenly, unevenly = (_term(Sighting(small, seen, T_seen, T_wc, 0), even=even) for even in (True, False))
    even, T = unevenly.noise > _UNEVEN * evenly.noise, T_wc
    for level in reversed(range(len(small.levels))):
        T = turned_on_level(Sighting(small, seen, T_seen, T, level), even=even)
    before, after = (evenly if even else unevenly), _term(Sighting(small, seen, T_seen, T, 0), even=even)
    return T if after.seen >= _LEAST_SEEN and after.noise < before.noise else T_wc


def turned_on_level(sighting: Sighting, *, even: bool = True) -> Tensor:
    """The frame's pose after Gauss-Newton steps of its turn on one level."""
    return pick(sighting.T_wc, compiled=compiled_turned_on_level, plain=plain_turned_on_level)(sighting, even=even)


def compiled_turned_on_level(sighting: Sighting, *, even: bool = True) -> Tensor:
    """`turned_on_level` by Numba, on the CPU."""
    from idfslam.alignment.kernels.numba_landmarks import turn_on_level

    T, marks, at = sighting.T_wc.clone(), sighting.marks, sighting.level
    landmarks, limits = (marks.points.numpy(), marks.luminance[at].numpy()), (_STEPS, _CONVERGED)
    weights = _NOISE, _ROBUST, even, INDEPENDENT, _TURN
    turn_on_level(*landmarks, sighting.T_wk.numpy(), T.numpy(), *sighting.frame.numbers[at], *weights, *limits)  # type: ignore[call-arg]
    return T


def plain_turned_on_level(sighting: Sighting, *, even: bool = True) -> Tensor:
    """`turned_on_level` in torch, on any device."""
    T, prior, change = sighting.T_wc, np.eye(3) / _TURN**2, np.zeros(6)
    for _ in range(_STEPS):
        sums = _term(replace(sighting, T_wc=T), even=even).sums
        change[3:] = np.linalg.solve(INDEPENDENT * sums.H[0, 3:, 3:] + prior, INDEPENDENT * sums.b[0, 3:])
        T = moved(T, torch.from_numpy(change))
        if np.abs(change).max() < _CONVERGED:
            break
    return T


def _term(sighting: Sighting, *, even: bool) -> Term:
    return photometric_term(sighting, floor=_NOISE, widest=_ROBUST, even=even)
