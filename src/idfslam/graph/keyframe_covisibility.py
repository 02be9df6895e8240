"""How much two keyframes see of the same (Eq. 5), at their present poses."""

from collections.abc import Sequence

import torch
from torch import Tensor

from idfslam.geometry import se3
from idfslam.graph.covisibility import covisibility
from idfslam.graph.keyframe import Keyframe

_HIDING = 1e-3  # [m] depth that stands for what hides all behind it. More: nothing, up to the nearest surface


def covisibilities(keyframe: Keyframe, stored: Sequence[Keyframe]) -> Tensor:
    """(K,) the share of a keyframe's readings that each of the stored keyframes has in view."""
    if not stored:
        return torch.zeros(0)
    T_kn = (se3.inverse(torch.stack([k.T_wk for k in stored])) @ keyframe.T_wk).to(keyframe.depth)
    return covisibility(keyframe.depth, keyframe.camera, T_kn, [k.camera for k in stored]).cpu()


def mutual_covisibility(a: Keyframe, b: Keyframe) -> float:
    """The smaller share of both directions, without what is occluded. A distant view has all of a near one in view, but shows little."""
    T_ba = se3.inverse(b.T_wk) @ a.T_wk
    directions = ((a, b, T_ba), (b, a, se3.inverse(T_ba)))
    return min(float(covisibility(n.depth, n.camera, T[None].to(n.depth), [k.camera], [k.depth])) for n, k, T in directions)


def unmasked_covisibility(keyframe: Keyframe, stored: Keyframe) -> float:
    """The share without what moving things hid in the stored keyframe: nothing was learnt there. 1 where nothing is hidden."""
    if stored.moving is None:
        return 1.0
    hiding = torch.from_numpy(stored.moving).to(keyframe.depth) * _HIDING
    T_kn = (se3.inverse(stored.T_wk) @ keyframe.T_wk).to(keyframe.depth)
    return float(covisibility(keyframe.depth, keyframe.camera, T_kn[None], [stored.camera], [hiding]))
