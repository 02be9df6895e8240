"""Doubt: is an aligned pose wrong? The evidence is the displacement of the image that is left at it, against what is usual.

The probability that a pose is off by more than 5 cm or 2 degrees is logistic in the logarithm of that ratio. Other evidence (depth, the
overlap, the covariance, the prior of the motion) was tried with it: it helps in the recordings that it is fitted to, and not in others
(docs/findings.md). `benchmarks/fit_doubt.py` fits the coefficients.
"""

import math

from idfslam.storage.state import State, Stateful

# [1] Coefficients of the logistic model: P = 1 / (1 + exp(-(slope ln ratio + offset))). Fitted by `benchmarks/fit_doubt.py` to generated
# hand-held recordings and to wrong poses provoked there. More of the slope: fewer ratios are undecided. More of the offset: more doubt.
_SLOPE, _OFFSET = 5.0, -5.7
# [rad] Least displacement that counts as usual (0.2 degrees): that of a rendered image with a sensor's noise. More: less doubt where
# images are exact. From the same recordings.
_LEAST_USUAL = math.radians(0.2)
# [1] Probability above which a pose is doubtful. More: fewer frames are doubtful, and more wrong ones are not. Chosen on the same
# recordings, where one in a hundred right poses is above it.
_DOUBTFUL = 0.15
# [rad] Most displacement that counts as usual (0.6 degrees): a pose off by 2 degrees turns each landmark by as much, of which a gradient of
# any direction shows the cosine, 0.7 in the median. What is usual has to leave that doubtful, or nothing could be told: it is less by the
# ratio that has the probability `_DOUBTFUL`, 2.2. More: images that contradict their poses throughout are sooner taken for usual. Derived;
# it is 0.2 to 0.4 degrees in hand-held recordings.
_MOST_USUAL = math.radians(2) * math.cos(math.pi / 4) / math.exp((math.log(_DOUBTFUL / (1 - _DOUBTFUL)) - _OFFSET) / _SLOPE)
# [1] Least step a frame of the running median of displacements (stochastic approximation, Robbins and Monro 1951): that of frame n is 1 / n
# before. More: what is usual follows the last frames faster, and a passage of wrong poses is sooner taken for usual. Chosen by hand; with
# 0.02 as many are told apart.
_STEP = 0.01


class PoseDoubt(Stateful):
    """Knows the usual displacement of a recording, its median, and judges displacements by it."""

    def __init__(self) -> None:
        self._usual = 0.0  # [rad]; 0: not known yet
        self._frames = 0  # that it was learnt from

    def state(self) -> State:
        """The usual displacement, and the number of frames that it was learnt from."""
        return {"usual": self._usual, "frames": self._frames}

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        self._usual, self._frames = state["usual"], state["frames"]

    def probability(self, displacement: float) -> float:
        """The probability (0 to 1) that a pose with this displacement [rad] is off by more than 5 cm or 2 degrees.

        Right and wrong poses are taken to be equally frequent. A displacement of 0 says nothing: the probability is 0 then.
        """
        if displacement <= 0:
            return 0.0
        return 1 / (1 + math.exp(-(_SLOPE * math.log(self.ratio(displacement)) + _OFFSET)))

    def ratio(self, displacement: float) -> float:
        """A displacement [rad] over the usual one."""
        return displacement / min(max(self._usual, _LEAST_USUAL), _MOST_USUAL)

    def is_doubtful(self, displacement: float) -> bool:
        """Whether a pose with this displacement [rad] is not to be trusted."""
        return self.probability(displacement) > _DOUBTFUL

    def expect(self, displacements: list[float]) -> None:
        """Takes the median of some displacements [rad] of right poses as the usual one. One of 0 says nothing, and is left out."""
        if measured := sorted(displacement for displacement in displacements if displacement > 0):
            self._usual, self._frames = measured[len(measured) // 2], len(measured)

    def accept(self, displacement: float) -> None:
        """Learns from the displacement [rad] of an accepted pose. A doubtful one counts by the probability that it is right."""
        if displacement > 0:
            right = 1 - self.probability(displacement) if self.has_usual and self.is_doubtful(displacement) else 1.0
            self._frames += 1
            step = right * max(1 / (self._frames + 1), _STEP)
            self._usual = self._usual * (1 + step) ** math.copysign(1, displacement - self._usual) or displacement

    @property
    def has_usual(self) -> bool:
        """Whether the usual displacement is known."""
        return self._usual > 0


def doubtful_ratio() -> float:
    """The ratio to the usual displacement above which a pose is doubtful."""
    return math.exp((math.log(_DOUBTFUL / (1 - _DOUBTFUL)) - _OFFSET) / _SLOPE)
