"""Adam without torch's compiler: torch's steps, and none of its modules."""

import subprocess
import sys

import pytest
import torch
from torch import nn

from idfslam.compute.adam import Adam


@pytest.mark.parametrize("fused", [None, True])
def test_steps_are_those_of_torch(fused: bool | None) -> None:
    def learnt(make: type[torch.optim.Adam]) -> torch.Tensor:
        weights = nn.Parameter(torch.randn(50, 7, generator=torch.Generator().manual_seed(0)))
        adam = make([weights], lr=0.01, fused=fused)
        for _ in range(5):
            adam.zero_grad()
            (weights**3).sum().backward()
            adam.step()
            adam.load_state_dict(adam.state_dict())
        return weights.detach()

    assert torch.equal(learnt(Adam), learnt(torch.optim.Adam))


@pytest.mark.slow
def test_a_system_does_without_torchs_compiler() -> None:
    program = """if True:
        import sys, torch
        from idfslam.compute.devices import repeatable
        from idfslam.slam import Slam
        Slam().back_end.finetuner.tracker.optimiser.step()
        with repeatable(torch.device("cpu")):
            print("torch._dynamo" in sys.modules)
    """
    assert subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout == "False\n"
