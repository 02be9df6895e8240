"""Torch's Adam without torch's compiler.

The methods of torch's optimisers are wrapped to keep its compiler (`torch._dynamo`) out of them. The wrappers import it for that: 830
modules and 1.4 s at the start of each process. These methods are what is within the wrappers, so steps are torch's to the last bit.
"""

from inspect import unwrap

import torch


class Adam(torch.optim.Adam):
    """Adam with the arguments and the state of `torch.optim.Adam`. No closure, and no step is differentiated."""

    add_param_group = unwrap(torch.optim.Adam.add_param_group)
    zero_grad = unwrap(torch.optim.Adam.zero_grad)
    state_dict = unwrap(torch.optim.Adam.state_dict)
    load_state_dict = unwrap(torch.optim.Adam.load_state_dict)
    step = torch.no_grad()(unwrap(torch.optim.Adam.step))
