"""The usual photometric error: the scale of the brightness differences of frames at right poses. It differs from camera to camera."""

from collections.abc import Sequence

from idfslam.storage.state import State, Stateful

# All of these were chosen by hand on generated rooms and redkitchen.
# [1] Rate of the running mean. More: the mean follows the last frames faster.
_RATE = 0.1
# [1] The same for a doubtful frame. More: a long passage that contradicts the images is sooner taken for usual.
_DOUBTFUL_RATE = 0.03


class UsualError(Stateful):
    """A running mean of photometric errors [1]."""

    def __init__(self, least: float, doubtful: float) -> None:
        """least: value below which it counts as that: noise of the sensor. doubtful: ratio to it above which an error is doubtful."""
        self.least, self.doubtful_ratio = least, doubtful
        self._mean = 0.0  # 0: not known yet

    def state(self) -> State:
        """The mean."""
        return {"mean": self._mean}

    def restore(self, state: State) -> None:
        """Takes over `state`."""
        self._mean = state["mean"]

    @property
    def is_known(self) -> bool:
        """Whether a frame was aligned, or `expect` was called."""
        return self._mean > 0

    @property
    def doubtful(self) -> float:
        """The error above which two images do not show the same place: it is more than noise."""
        return self.doubtful_ratio * max(self._mean, self.least)

    def is_within(self, error: float, ratio: float) -> bool:
        """Whether an error is at most `ratio` times the usual one."""
        return error <= ratio * max(self._mean, self.least)

    def expect(self, errors: Sequence[float]) -> None:
        """Starts with the median of some errors, before the first alignment. An error of 0, for nothing in view, is left out."""
        if measured := sorted(error for error in errors if error > 0):
            self._mean = measured[len(measured) // 2]

    def accept(self, error: float) -> None:
        """Takes over the error of a frame; 0: nothing was in view.

        A doubtful one counts as just doubtful, and at a lower rate: a wrong pose does not soon make its like usual.
        """
        if error <= 0:
            return
        rate = 1.0 if not self._mean else _DOUBTFUL_RATE if error > self.doubtful else _RATE
        bounded = min(error, self.doubtful) if self._mean else error
        self._mean += (bounded - self._mean) * rate
