"""The photometric part of the normal equations: a frame's image against the landmarks of several keyframes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from torch import Tensor

from idfslam.alignment.frame_motion import FrameMotion, numbers_of
from idfslam.alignment.photometric import Term, photometric_term
from idfslam.alignment.posed_landmarks import PosedLandmarks
from idfslam.alignment.row_moments import PoseEquations, RowMoments
from idfslam.alignment.sighting import Appearance, Sighting
from idfslam.compute.backend import pick
from idfslam.config import AlignmentConfig


@dataclass(frozen=True)
class ImageTerm(PoseEquations):
    """The photometric part of the normal equations, in units of the depth's."""

    photometric_error: float  # scale of the brightness differences [1]
    in_view: float  # share of the references' landmarks that are in view
    parts: tuple[RowMoments, ...] = ()  # of each reference, and of the recent frame; `sums` is their sum


def image_term(
    frame: Appearance, posed: PosedLandmarks, T: Tensor, level: int, motion: FrameMotion | None, config: AlignmentConfig
) -> ImageTerm:
    """The brightness of the landmarks of references, on a level of the pyramid of a frame at T (4, 4).

    motion: within the frame; with it, the sums have moments.
    """
    terms = pick(T, compiled=compiled_terms, plain=plain_terms)(frame, posed, T, level, motion, config)
    evidence = terms[: posed.evidence]
    enough = [term for term in evidence if term.seen >= config.min_landmarks]
    error = sum(term.seen * term.noise for term in enough) / max(sum(term.seen for term in enough), 1)
    in_view = sum(term.seen for term in evidence) / posed.count if posed.count else 1.0
    parts = tuple(term.sums for term in terms if term.seen >= config.min_landmarks)
    return ImageTerm(sum(parts, RowMoments.zeros(moments=motion is not None)), error, in_view, parts)


def plain_terms(
    frame: Appearance, posed: PosedLandmarks, T: Tensor, level: int, motion: FrameMotion | None, config: AlignmentConfig
) -> Sequence[Term]:
    """The term of each keyframe, in units of the depth's: one by one, on any device."""
    moments, noise, widest = motion is not None, config.colour_noise, config.colour_robust
    sightings = (Sighting(frame, marks, T_wk, T, level, motion) for marks, T_wk in posed.all)
    terms = (photometric_term(sighting, floor=noise, widest=widest, moments=moments) for sighting in sightings)
    return [Term(term.sums.scaled(config.depth_noise**2), term.seen, term.noise) for term in terms]


def compiled_terms(
    frame: Appearance, posed: PosedLandmarks, T: Tensor, level: int, motion: FrameMotion | None, config: AlignmentConfig
) -> Sequence[Term]:
    """`plain_terms` by Numba, on the CPU: all of them in one call."""
    from idfslam.alignment.kernels.numba_landmarks import photometric_systems

    n, moments = len(posed.all), motion is not None
    if not n:
        return []
    H, b = np.empty((n, 3 if moments else 1, 6, 6)), np.empty((n, 2 if moments else 1, 6))
    landmarks = posed.points, posed.luminance(level), posed.starts, posed.poses
    inputs = *landmarks, T.numpy(), *numbers_of(motion), *frame.numbers[level]
    seen, noise = photometric_systems(*inputs, config.colour_noise, config.colour_robust, config.depth_noise**2, H, b)  # type: ignore[call-arg]
    return [Term(RowMoments(*sums), *counted) for *sums, counted in zip(H, b, zip(seen.tolist(), noise.tolist()))]
