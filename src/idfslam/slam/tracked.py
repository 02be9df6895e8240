"""The result of tracking a frame: computed by a front end, and confirmed or replaced by recovery."""

from dataclasses import dataclass, field, replace
from enum import Enum

from torch import Tensor

from idfslam.alignment.alignment import Alignment
from idfslam.frame import Status
from idfslam.storage.state import State


class Source(Enum):
    """Where a frame's pose comes from."""

    FIRST = "first"  # the first frame with depth, which defines the world
    ALIGNED = "aligned"  # alignment to the map, from a predicted or registered pose
    REGISTERED = "registered"  # registration by the neural tracker against a keyframe (Sec. V)
    RELOCALISED = "relocalised"  # relocalisation of a lost camera among the keyframes
    NEW_SUBMAP = "new submap"  # a new submap, started by a lost camera
    PREDICTED = "predicted"  # the motion model alone: the frame is lost, or nothing measures its pose


@dataclass(frozen=True)
class Evidence:
    """The evidence for a pose besides its status. The defaults are those of a front end that does not measure it."""

    in_view: float = 1.0  # share of the references' landmarks that the frame sees
    mapped_share: float = 1.0  # share of the frame's depth that lies near a mapped surface
    step: float = 0.0  # [rad] motion of the image since the frame before, or since its prediction if that is more
    least_information: float = 0.0  # smallest eigenvalue of the information of map and images, per unit weight


@dataclass(frozen=True)
class Tracked:
    """A frame's pose, its source, and the evidence for it."""

    T_wc: Tensor  # (4, 4) float64
    status: Status
    source: Source
    evidence: Evidence = field(default_factory=Evidence)
    alignment: Alignment | None = None  # the alignment to the map that gave the pose, if one did
    clear: bool = True  # False: the image is too blurred, or too unlike the keyframes', to be mapped, whether its pose is right or not
    confident: bool = True  # False: the camera should be relocalised, and this pose taken only if that fails
    # (6, 6) float64 of the pose's error against the map around it, without drift: shift [m] of the camera's centre, then turn [rad], along
    # world axes. The true pose has the centre `t + shift` and the rotation `exp(turn) @ R`. None: not estimated
    covariance: Tensor | None = None

    @classmethod
    def first(cls, T_wc: Tensor, *, defines_world: bool = True) -> "Tracked":
        """The result for the frame that defines the world, or for one before it, which is lost."""
        return cls(T_wc, Status.OK if defines_world else Status.LOST, Source.FIRST)

    @classmethod
    def aligned(cls, alignment: Alignment, source: Source = Source.ALIGNED, *, doubtful: bool = False, clear: bool = True) -> "Tracked":
        """The result of an alignment that is not lost. doubtful: its pose is not to be trusted. clear: its image may be mapped."""
        evidence = Evidence(alignment.in_view, alignment.overlap, least_information=alignment.least_information)
        status = Status.DOUBTFUL if doubtful else alignment.status
        return cls(alignment.T_wc, status, source, evidence, alignment, clear, covariance=alignment.covariance)

    def lost(self, T_predicted: Tensor) -> "Tracked":
        """The same frame as lost, at its predicted pose (4, 4)."""
        evidence = replace(self.evidence, least_information=0.0)
        return Tracked(T_predicted, Status.LOST, Source.PREDICTED, evidence)

    def state(self) -> State:
        """All fields but the alignment, which later frames do not need."""
        words = {"status": self.status.value, "source": self.source.value, "clear": self.clear, "confident": self.confident}
        return {"T_wc": self.T_wc, "evidence": vars(self.evidence).copy(), "covariance": self.covariance, **words}

    @classmethod
    def from_state(cls, state: State) -> "Tracked":
        """The result that `state` was made from, without its alignment."""
        status, source, evidence = Status(state["status"]), Source(state["source"]), Evidence(**state["evidence"])
        flags = {name: state[name] for name in ("clear", "confident")}
        return cls(state["T_wc"], status, source, evidence, covariance=state["covariance"], **flags)

    @property
    def is_lost(self) -> bool:
        return self.status is Status.LOST

    @property
    def may_be_mapped(self) -> bool:
        """Whether the map may learn from the frame, if it has depth."""
        return self.clear and self.status.trusted

    @property
    def continues_motion(self) -> bool:
        """Whether the change from the pose before is the motion of one frame."""
        return self.source in (Source.ALIGNED, Source.REGISTERED)
