"""Single photographs and low frame rates: each view is far from where the last ones predict it."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from helpers.flat_wall import PAPER, at, keyframe, wall_frames
from idfslam.alignment.alignment import Alignment
from idfslam.alignment.continuous_motion import MotionPrior
from idfslam.config import FAST
from idfslam.datasets import Selection
from idfslam.datasets.generated.room import SyntheticRoom
from idfslam.frame import Status
from idfslam.geometry import se3
from idfslam.geometry.trajectory import align
from idfslam.graph.keyframe_selection import KeyframeSelection
from idfslam.slam import Slam
from idfslam.slam.front_end.alignment_to_map import AlignmentToMap
from idfslam.slam.front_end.registered_pose import RegisteredPose
from idfslam.tracking.tracker import TrackingResult

SURE = np.diag([1e-5, 1e-5, 1e-5, 1e-6, 1e-6, 1e-6])
T_KC = se3.exp(torch.tensor([0.1, 0.0, 0.05, 0.0, 0.3, 0.0], dtype=torch.float64))


class Patches:
    """Forty patches, which a pose loses with its distance from the true one: half of them at 1 cm."""

    def agree(self, T_kc: torch.Tensor, T_by_image: torch.Tensor) -> bool:
        return float((T_kc - T_by_image)[:3, 3].norm()) < 0.01


def registered(patches: int = 40, status: Status = Status.OK, covariance: np.ndarray | None = SURE) -> RegisteredPose:
    """A view registered with a keyframe at x = 0.5 m that is turned by 90 degrees."""
    result = TrackingResult(T_KC.numpy(), status, 100, 50, 0.01, covariance, patches, Patches())  # type: ignore[arg-type]
    reference = keyframe(0, 0.0)
    reference.T_wk = at(0.5, 90)
    return RegisteredPose(reference, result)


def aligned(shift: float, status: Status = Status.OK) -> Alignment:
    """An alignment so far [m] from the registered pose."""
    T = registered().T_wc.clone()
    T[2, 3] += shift
    return Alignment(T, status, 1.0, 0.001, 0.1, 0.01, 1.0, None, 5)


def test_the_image_decides_between_map_and_tracker() -> None:
    assert registered().confirms(aligned(0.005))
    assert not registered().refutes(aligned(0.005))
    assert registered().refutes(aligned(0.02))
    assert not registered().confirms(aligned(0.02))
    assert registered().refutes(aligned(0.0, Status.LOST))


def test_a_registered_pose_is_the_prior_of_the_alignment_from_it() -> None:
    """Its pose, as sure as it is, in place of the predicted one, 4 cm away; that of the velocity stays. An unsure one changes nothing."""
    information = np.eye(12) * 100.0
    information[:6, 6:] = information[6:, :6] = 50.0 * np.eye(6)  # of the velocity alone 75
    motion = MotionPrior(aligned(0.04).T_wc, np.arange(6.0), information)
    prior = registered().prior(motion)
    assert torch.equal(prior.T_wc, registered().T_wc) and np.array_equal(prior.velocity, motion.velocity)
    assert registered().covariance is not None
    assert np.allclose(np.linalg.inv(prior.information[:6, :6]), registered().covariance)
    assert np.allclose(prior.information[6:, 6:], 75.0 * np.eye(6))
    assert not prior.information[:6, 6:].any()
    assert registered(covariance=None).prior(motion) is motion


def test_poses_by_map_and_tracker_are_apart_from_five_centimetres_on() -> None:
    assert not registered().is_apart(aligned(0.04))
    assert registered().is_apart(aligned(0.06))


def test_the_displacement_at_a_registration_is_compared_with_that_of_the_alignment() -> None:
    """8 mrad are left at the registered pose, 10 at the alignment; 0 says nothing."""
    front_end = Slam(FAST).front_end
    assert isinstance(front_end, AlignmentToMap)
    front_end._references = list  # type: ignore[method-assign,assignment]
    for at_registered, at_aligned, ratio in ((8e-3, 0.01, 0.8), (0, 0.01, 1), (8e-3, 0, 1)):
        front_end.aligner.displacement = lambda *_, value=at_registered: value  # type: ignore[method-assign,assignment]
        displaced = front_end._displaced(keyframe(1, 0.0), registered(), replace(aligned(0.02), displacement=at_aligned))
        assert displaced == pytest.approx(ratio)


@pytest.mark.parametrize("weak", [registered(patches=19), registered(status=Status.LOST)])
def test_few_patches_decide_nothing(weak: RegisteredPose) -> None:
    for alignment in (aligned(0.0), aligned(0.02)):
        assert not weak.confirms(alignment)
        assert not weak.refutes(alignment)


@pytest.mark.parametrize(("shift", "turn", "sure"), [(0.024, 0.9, True), (0.026, 0.9, False), (0.024, 1.1, False)])
def test_patches_in_a_strip_confirm_nothing(shift: float, turn: float, sure: bool) -> None:
    """They agree with poses that are turned about the strip: the covariance tells. shift [m], turn [degrees]: expected errors."""
    one_direction = np.diag([shift**2, 0, 0, 0, np.radians(turn) ** 2, 0])
    pose = replace(registered(covariance=one_direction), reference=keyframe(0, 0.0))
    pose = replace(pose, result=replace(pose.result, T_kc=np.eye(4)))
    assert pose.is_sure == pose.confirms(replace(aligned(0.0), T_wc=pose.T_wc)) == sure
    assert not registered(covariance=None).is_sure


def test_the_covariance_is_that_of_the_pose_in_the_world() -> None:
    # exp(delta) T_kc moves the centre by the shift and by the turn about the keyframe's centre.
    generator = torch.Generator().manual_seed(0)
    root = torch.randn(6, 6, generator=generator, dtype=torch.float64) * 1e-4
    pose = registered(covariance=(root @ root.T).numpy())
    deltas = (root @ torch.randn(6, 20000, generator=generator, dtype=torch.float64)).T
    moved = pose.reference.T_wk @ se3.exp(deltas) @ T_KC
    turns = se3.log(moved @ se3.inverse(pose.T_wc))[:, 3:]
    changes = torch.cat([moved[:, :3, 3] - pose.T_wc[:3, 3], turns], -1)
    assert pose.covariance is not None
    torch.testing.assert_close(pose.covariance, changes.T.cov(), rtol=0.1, atol=1e-9)
    assert registered(covariance=None).covariance is None


def test_a_frame_that_nobody_predicted_becomes_a_keyframe_at_once() -> None:
    frames = wall_frames(places=(0.0,))
    selection, view = KeyframeSelection(PAPER, frames.graph, frames, lost_frames=True), keyframe(9, 0.01)
    assert not selection.selects(view, Status.OK, step=0.11)
    assert selection.selects(view, Status.OK, step=0.13)
    assert not selection.selects(view, Status.DOUBTFUL, step=0.13)


@pytest.mark.slow
def test_a_room_is_mapped_in_steps_of_twenty_centimetres() -> None:
    """Half of the steps turn by more than 16 degrees, up to 28. Alignment alone loses the camera after a third of them."""
    room = Selection(SyntheticRoom(seed=1, width=320, height=240, noise=True), stride=20)
    slam = Slam(replace(FAST, refine=False))
    for i in range(len(room)):
        slam.process(room[i])
    slam.finish()
    assert {status.value for status in slam.statuses()} == {"ok"}
    assert room.ground_truth is not None
    found, true = slam.trajectory()[:, :3, 3], room.ground_truth[:, :3, 3]
    T = align(found, true)
    assert np.sqrt(((found @ T[:3, :3].T + T[:3, 3] - true) ** 2).sum(1).mean()) < 0.01  # 0.6 cm
