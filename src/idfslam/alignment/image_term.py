"""The photometric part of the normal equations: a frame's image against the landmarks of several keyframes."""

from collections.abc import Sequence
from dataclasses import dataclass

from torch import Tensor

from idfslam.alignment.frame_motion import FrameMotion
from idfslam.alignment.landmarks import Landmarks
from idfslam.alignment.photometric import photometric_term
from idfslam.alignment.row_moments import PoseEquations, RowMoments
from idfslam.alignment.sighting import Appearance, Sighting
from idfslam.config import AlignmentConfig

Posed = tuple[Landmarks, Tensor]
"""Landmarks of a keyframe, and its pose (4, 4) float64."""


@dataclass(frozen=True)
class ImageTerm(PoseEquations):
    """The photometric part of the normal equations, in units of the depth's."""

    photometric_error: float  # scale of the brightness differences [1]
    in_view: float  # share of the references' landmarks that are in view
    parts: tuple[RowMoments, ...] = ()  # of each reference, and of the recent frame; `sums` is their sum


def image_term(
    frame: Appearance,
    posed: Sequence[Posed],
    T: Tensor,
    level: int,
    motion: FrameMotion | None,
    config: AlignmentConfig,
    recent: Posed | None = None,
) -> ImageTerm:
    """The brightness of the references' `posed` landmarks, on a level of the pyramid of a frame at T (4, 4).

    motion: within the frame; with it, the sums have moments. recent: of a frame shortly before, which is no evidence for the pose.
    """
    moments, noise, widest = motion is not None, config.colour_noise, config.colour_robust
    terms = [
        photometric_term(Sighting(frame, marks, T_wk, T, level, motion), floor=noise, widest=widest, moments=moments)
        for marks, T_wk in [*posed, *([] if recent is None else [recent])]
    ]
    parts = tuple(term.sums.scaled(config.depth_noise**2) for term in terms if term.seen >= config.min_landmarks)
    evidence = terms[: len(posed)]  # without the recent frame
    enough = [term for term in evidence if term.seen >= config.min_landmarks]
    error = sum(term.seen * term.noise for term in enough) / max(sum(term.seen for term in enough), 1)
    count = sum(len(marks.points) for marks, _ in posed)
    in_view = sum(term.seen for term in evidence) / count if count else 1.0
    return ImageTerm(sum(parts, RowMoments.zeros(moments=moments)), error, in_view, parts)
