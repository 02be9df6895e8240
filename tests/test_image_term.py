"""The landmarks of several keyframes in one call, against the terms of each."""

import numpy as np
import pytest

from idfslam.alignment.frame_motion import FrameMotion
from idfslam.alignment.image_term import compiled_terms, image_term, plain_terms
from idfslam.alignment.posed_landmarks import PosedLandmarks
from idfslam.config import AlignmentConfig
from idfslam.sensing.rectification import RowTimes
from test_photometric import appearance, marks_at, pose

KEYFRAMES = [pose(0.1, 0.02, 0, 0.01, 0.05, 0), pose(0.12, 0.0, 0.02, 0.0, 0.02, 0.01)]
T_WC = pose(0.13, 0, 0.04, 0.0, 0.03, 0.02)
CONFIG = AlignmentConfig(min_landmarks=20)
MOVING = FrameMotion(RowTimes(0.03, 0.02, -0.01), np.array([0.3, -0.2, 0.1, 0.8, -1.0, 1.5]))


@pytest.mark.parametrize("motion", [None, MOVING])
def test_the_compiled_terms_are_the_plain_ones(motion: FrameMotion | None) -> None:
    posed, frame = PosedLandmarks([(marks_at(T), T) for T in KEYFRAMES], (marks_at(T_WC), T_WC)), appearance(T_WC, gain=0.9)
    found, plain = (form(frame, posed, T_WC, 0, motion, CONFIG) for form in (compiled_terms, plain_terms))
    assert [term.seen for term in found] == [term.seen for term in plain]
    for term, expected in zip(found, plain):
        assert term.noise == pytest.approx(expected.noise, rel=5e-3)
        for sums, of_expected in ((term.sums.H, expected.sums.H), (term.sums.b, expected.sums.b)):
            np.testing.assert_allclose(sums, of_expected, rtol=0, atol=2e-2 * np.abs(expected.sums.H[0]).max())


def test_a_recent_frame_draws_the_pose_and_is_no_evidence() -> None:
    references, frame = [(marks_at(T), T) for T in KEYFRAMES], appearance(T_WC)
    alone = image_term(frame, PosedLandmarks(references), T_WC, 0, None, CONFIG)
    both = image_term(frame, PosedLandmarks(references, (marks_at(T_WC), T_WC)), T_WC, 0, None, CONFIG)
    assert (both.in_view, both.photometric_error) == (alone.in_view, alone.photometric_error)
    assert len(both.parts) == 3 and len(alone.parts) == 2
    np.testing.assert_allclose(both.sums.H, alone.sums.H + both.parts[2].H)


def test_without_keyframes_there_are_no_equations() -> None:
    nothing = image_term(appearance(T_WC), PosedLandmarks([]), T_WC, 0, MOVING, CONFIG)
    assert not nothing.sums.H.any() and nothing.sums.H.shape == (3, 6, 6) and nothing.in_view == 1.0
