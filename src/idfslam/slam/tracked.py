"""What tracking found out about a frame: the answer of a front end, confirmed or corrected by recovery."""

from dataclasses import dataclass, field, replace
from enum import Enum

from torch import Tensor

from idfslam.alignment.aligner import Alignment
from idfslam.frame import Status
from idfslam.storage.state import State


class Source(Enum):
    """Where a frame's pose comes from."""

    FIRST = "first"  # the first frame with depth: the world
    ALIGNED = "aligned"  # to the map, from a predicted or registered pose
    REGISTERED = "registered"  # by the neural tracker against a keyframe (Sec. V)
    RELOCALISED = "relocalised"  # a lost camera that was found among the keyframes
    NEW_SUBMAP = "new submap"  # a lost camera that was not found: it begins a submap
    PREDICTED = "predicted"  # by the motion model alone: lost


@dataclass(frozen=True)
class Evidence:
    """What speaks for a pose beside its status; the defaults are those of a front end that does not measure it."""

    in_view: float = 1.0  # share of the references' landmarks that the frame sees
    mapped_share: float = 1.0  # share of its depth that lies where the map knows the surface
    least_information: float = 0.0  # that map and images have of the pose in any direction, per unit weight


@dataclass(frozen=True)
class Tracked:
    """A frame's pose, how it was found, and what speaks for it."""

    T_wc: Tensor  # (4, 4) float64
    status: Status
    source: Source
    evidence: Evidence = field(default_factory=Evidence)
    alignment: Alignment | None = None  # to the map, where the pose comes from one
    confident: bool = True  # False: better than none, but a lost camera may be looked for instead

    @classmethod
    def first(cls, T_wc: Tensor, *, has_depth: bool) -> "Tracked":
        """The first frame with depth is the world; frames before it are lost."""
        return cls(T_wc, Status.OK if has_depth else Status.LOST, Source.FIRST)

    @classmethod
    def aligned(cls, alignment: Alignment, source: Source = Source.ALIGNED) -> "Tracked":
        """By an alignment that is not lost."""
        evidence = Evidence(alignment.in_view, alignment.overlap, alignment.least_information)
        return cls(alignment.T_wc, alignment.status, source, evidence, alignment)

    def lost(self, T_predicted: Tensor) -> "Tracked":
        """The frame as lost: it stays at its predicted pose (4, 4)."""
        evidence = replace(self.evidence, least_information=0.0)
        return Tracked(T_predicted, Status.LOST, Source.PREDICTED, evidence)

    def state(self) -> State:
        """Without the alignment, which the next frames do not need."""
        words = {"status": self.status.value, "source": self.source.value, "confident": self.confident}
        return {"T_wc": self.T_wc, "evidence": vars(self.evidence).copy(), **words}

    @classmethod
    def from_state(cls, state: State) -> "Tracked":
        """What `state` was made of."""
        status, source, evidence = Status(state["status"]), Source(state["source"]), Evidence(**state["evidence"])
        return cls(state["T_wc"], status, source, evidence, confident=state["confident"])

    @property
    def is_lost(self) -> bool:
        return self.status is Status.LOST

    @property
    def continues_motion(self) -> bool:
        """Whether the way from the frame before is the motion of one frame."""
        return self.source in (Source.ALIGNED, Source.REGISTERED)
