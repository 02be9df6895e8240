"""The poses of the frames of a window, moved by Adam while a map is optimised with them."""

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from idfslam.compute.adam import Adam
from idfslam.geometry import se3
from idfslam.mapping.training_view import PosedFrame


class WindowPoses:
    """An increment for each frame that may move, made when the frame first takes part. Each has an Adam of its own."""

    def __init__(self, rate: float, device: torch.device, may_move: Callable[[PosedFrame], bool]) -> None:
        """rate: learning rate of Adam [m, rad]. may_move: whether a frame's pose is optimised."""
        self.rate, self.device, self.may_move = rate, device, may_move
        self._moving: dict[PosedFrame, tuple[Tensor, Adam]] = {}

    def of(self, frame: PosedFrame, *, moving: bool = True) -> Tensor:
        """T_wc (4, 4) float32 of a frame; differentiable in its increment if it moves."""
        start = frame.T_wk.float().to(self.device)
        if not self.may_move(frame):
            return start
        if frame not in self._moving:
            xi = torch.zeros(6, device=self.device, requires_grad=True)
            self._moving[frame] = xi, Adam([xi], lr=self.rate)
        xi = self._moving[frame][0]
        return start @ se3.exp(xi if moving else xi.detach())

    def zero_grad(self) -> None:
        """Clears the gradients."""
        for xi, _ in self._moving.values():
            xi.grad = None

    def step(self) -> None:
        """A step of Adam for each frame with a gradient."""
        for _, adam in self._moving.values():
            adam.step()

    def poses(self) -> list[tuple[PosedFrame, Tensor]]:
        """The frames that moved, with their poses T_wk (4, 4) float64."""
        return [(frame, se3.orthonormal(frame.T_wk @ se3.exp(xi.detach().double().cpu()))) for frame, (xi, _) in self._moving.items()]


def oldest(frames: Sequence[PosedFrame]) -> PosedFrame:
    """The frame with the smallest index."""
    return min(frames, key=lambda frame: frame.index)
