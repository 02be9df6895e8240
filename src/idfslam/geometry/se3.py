"""SE(3) as plain (..., 4, 4) tensors; increments are 6-vectors (translation first, then rotation) [m, rad].

`T_ab` maps points of frame b into frame a, so that adjacent letters cancel: `T_wk @ T_kc = T_wc`.
"""

import math

import numpy as np
import torch
from torch import Tensor

_SMALL = 0.03  # [rad] below this angle Taylor series replace the closed forms, which (and worse, their gradients) lose digits in float32
_NEAR_PI = -0.9  # below this cosine of the angle the axis comes from the symmetric part of R, since the skew part vanishes at pi


def hat(omega: Tensor) -> Tensor:
    """The skew-symmetric matrix (..., 3, 3) of a vector (..., 3): `hat(a) @ b = a x b`."""
    x, y, z = omega.unbind(-1)
    zero = torch.zeros_like(x)
    return torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).unflatten(-1, (3, 3))


def _vee(R: Tensor) -> Tensor:
    """The vector (..., 3) of the skew-symmetric part of (..., 3, 3); of a rotation, its axis times the sine of its angle."""
    return torch.stack([R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], -1) / 2


def _coefficients(theta2: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """sin(t)/t, (1-cos t)/t^2, (t-sin t)/t^3 from t^2, smooth (also in their gradients) at zero."""
    small = theta2 < _SMALL**2
    safe = torch.where(small, torch.ones_like(theta2), theta2)
    theta = safe.sqrt()
    a = torch.where(small, 1 - theta2 / 6 + theta2**2 / 120 - theta2**3 / 5040, theta.sin() / theta)
    b = torch.where(small, 0.5 - theta2 / 24 + theta2**2 / 720 - theta2**3 / 40320, 2 * (theta / 2).sin() ** 2 / safe)
    c = torch.where(small, 1 / 6 - theta2 / 120 + theta2**2 / 5040 - theta2**3 / 362880, (theta - theta.sin()) / (safe * theta))
    return a, b, c


def exp(xi: Tensor) -> Tensor:
    """The transform (..., 4, 4) of an increment (..., 6); differentiable at zero."""
    if xi.dim() == 1 and xi.device.type == "cpu" and not xi.requires_grad:
        return _exp_of_numbers(xi)
    v, omega = xi[..., :3], xi[..., 3:]
    a, b, c = (k[..., None, None] for k in _coefficients((omega * omega).sum(-1)))
    W = hat(omega)
    WW = W @ W
    eye = torch.eye(3, dtype=xi.dtype, device=xi.device)
    R = eye + a * W + b * WW
    t = (eye + b * W + c * WW) @ v[..., None]
    bottom = torch.zeros_like(xi[..., :4])[..., None, :] + torch.tensor([0.0, 0, 0, 1], dtype=xi.dtype, device=xi.device)
    return torch.cat([torch.cat([R, t], -1), bottom], -2)


def _exp_of_numbers(xi: Tensor) -> Tensor:
    """`exp` of one increment (6,), in numbers of Python: thirty operations on tensors of three numbers take twenty times as long."""
    *v, x, y, z = xi.tolist()
    theta2 = x * x + y * y + z * z
    if theta2 < _SMALL**2:
        a = 1 - theta2 / 6 + theta2**2 / 120 - theta2**3 / 5040
        b = 0.5 - theta2 / 24 + theta2**2 / 720 - theta2**3 / 40320
        c = 1 / 6 - theta2 / 120 + theta2**2 / 5040 - theta2**3 / 362880
    else:
        theta = math.sqrt(theta2)
        a, b, c = math.sin(theta) / theta, 2 * math.sin(theta / 2) ** 2 / theta2, (theta - math.sin(theta)) / (theta2 * theta)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = _by_series(a, b, x, y, z), np.array(_by_series(b, c, x, y, z)) @ v
    return torch.from_numpy(T).to(xi)


def _by_series(a: float, b: float, x: float, y: float, z: float) -> list[list[float]]:
    """I + a W + b W^2 (3, 3), where W is `hat` of (x, y, z)."""
    return [
        [1 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y],
        [b * x * y + a * z, 1 - b * (x * x + z * z), b * y * z - a * x],
        [b * x * z - a * y, b * y * z + a * x, 1 - b * (x * x + y * y)],
    ]


def log(T: Tensor) -> Tensor:
    """The increment (..., 6) of a transform (..., 4, 4), `exp(log(T)) = T`; its rotation angle is in [0, pi]."""
    R, t = T[..., :3, :3], T[..., :3, 3]
    vee = _vee(R)
    sine = vee.norm(dim=-1)
    cosine = (R.diagonal(dim1=-2, dim2=-1).sum(-1) - 1) / 2
    theta = torch.atan2(sine, cosine)
    scale = torch.where(sine < 1e-6, torch.ones_like(sine), theta / sine.clamp(min=1e-12))
    omega = vee * scale[..., None]
    near_pi = cosine < _NEAR_PI
    if bool(near_pi.any()):
        # (R + R^T)/2 = cos(theta) I + (1 - cos(theta)) a a^T: every column of S is a multiple of the axis a
        S = (R + R.mT) / 2 - cosine[..., None, None] * torch.eye(3, dtype=T.dtype, device=T.device)
        column = S.gather(-1, S.diagonal(dim1=-2, dim2=-1).argmax(-1)[..., None, None].expand(*S.shape[:-1], 1))[..., 0]
        axis = column / column.norm(dim=-1, keepdim=True)
        sign = torch.where((axis * vee).sum(-1, keepdim=True) < 0, -1.0, 1.0)
        omega = torch.where(near_pi[..., None], axis * sign * theta[..., None], omega)
    W = hat(omega)
    theta2 = (omega * omega).sum(-1)
    a, b, _ = _coefficients(theta2)
    small = theta2 < _SMALL**2
    d = torch.where(
        small, 1 / 12 + theta2 / 720 + theta2**2 / 30240, (1 - a / (2 * b)) / torch.where(small, torch.ones_like(theta2), theta2)
    )
    eye = torch.eye(3, dtype=T.dtype, device=T.device)
    v = (eye - W / 2 + d[..., None, None] * (W @ W)) @ t[..., None]
    return torch.cat([v[..., 0], omega], -1)


def inverse(T: Tensor) -> Tensor:
    """The inverse (..., 4, 4) of rigid transforms in closed form, `T_ab -> T_ba`."""
    if T.dim() == 2 and T.is_cpu and not T.requires_grad:
        return _inverse_of_one(T)
    R_t = T[..., :3, :3].mT
    top = torch.cat([R_t, -R_t @ T[..., :3, 3:]], -1)
    return torch.cat([top, T[..., 3:, :]], -2)


def _inverse_of_one(T: Tensor) -> Tensor:
    """`inverse` of one transform (4, 4), in numpy: seven operations on tensors of a few numbers take five times as long."""
    of_T = T.numpy()
    out = np.eye(4, dtype=of_T.dtype)
    out[:3, :3] = of_T[:3, :3].T
    out[:3, 3] = -out[:3, :3] @ of_T[:3, 3]
    return torch.from_numpy(out)


def transform(T_ab: Tensor, points_b: Tensor) -> Tensor:
    """Transforms points (..., N, 3) from frame b to frame a."""
    return points_b @ T_ab[..., :3, :3].mT + T_ab[..., None, :3, 3]


def angle(T: Tensor) -> Tensor:
    """Rotation angle (...) [rad] of transforms (..., 4, 4), in [0, pi]."""
    R = T[..., :3, :3]
    sine, cosine = _vee(R).norm(dim=-1), (R.diagonal(dim1=-2, dim2=-1).sum(-1) - 1) / 2
    return torch.atan2(sine, cosine)


def orthonormal(T: Tensor) -> Tensor:
    """The rigid transform nearest to T (..., 4, 4), by SVD of the rotation: without the rounding errors of long products."""
    U, _, Vt = np.linalg.svd(T[..., :3, :3].double().cpu().numpy())  # for single matrices numpy is several times as fast as torch
    U[..., 2] *= np.linalg.det(U @ Vt)[..., None]  # det +1: never a reflection
    out = T.clone()
    out[..., :3, :3] = torch.from_numpy(U @ Vt)
    return out
