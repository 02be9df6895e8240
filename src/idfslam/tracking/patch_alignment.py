"""Matches refined to a fraction of a pixel: patches of a keyframe are aligned to a frame's image, coarse to fine.

A patch is warped by its plane and the pose, and then moved in the frame until the two agree best (inverse compositional Lucas-Kanade: Baker
and Matthews, 2004; feature alignment: Forster et al., ICRA 2014). Brightness and contrast may differ. After each level of the pyramid, the
pose is estimated from all patches, so that each starts the next level where the others say that it lies.
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from idfslam.compute.backend import pick
from idfslam.geometry import se3
from idfslam.geometry.camera import Camera
from idfslam.sensing.depth_noise import difference_noise
from idfslam.tracking.frame_features import FrameFeatures
from idfslam.tracking.patches import Patches

# All of these were chosen by hand on generated pairs.
_HALF = 5  # [px] a patch has 2 x this + 1 pixels a side, on each level. More: surer and slower; edges disturb more patches
_ITERATIONS = 8  # most steps of a patch on a level. More: slower, a few more patches
_MAX_SHIFT = 6.0  # [px] largest correction on a level. More: worse poses are corrected, and more patches are aligned wrongly
_MIN_CONTRAST = 2.0  # [1 of 255] least standard deviation of a patch's brightness. More: fewer patches of bare surfaces
_LEAST_TEXTURE = 1e-3  # [1] least determinant of a patch's Hessian, over its squared trace. More: fewer patches on edges, which can slide
_CONVERGED = 0.01  # [px] shift below which a patch has converged. More: quicker, less exact
_MIN_CORRELATION = 0.8  # [1] least correlation of a patch with the image. More: fewer and surer patches
_CORRELATED = 4.0  # [1] factor on the variance of a position, because the noise of neighbouring pixels is alike. More: patches count less
_FLOOR = 0.5  # [px] least standard deviation of a position, for what no patch shows: distortion, points off their planes. More: less counts
_DEPTH_NOISE = 0.015  # [m] least standard deviation of depth at a patch: warps, and edges. More: the image counts more
_SCALES = (12.0, 4.0, 3.0)  # [standard deviations] scale of the robust weights, in each step. More: outliers count more
_INLIER = 3.0  # [standard deviations] largest residual of an inlier. More: more inliers
_AGREEING = 0.5  # [1] least share of the inliers of the pose by the image that another pose must keep to agree with it. More: fewer agree
_STRETCH = 0.15, 6.0  # [1] least and largest ratio of a patch's areas in the two images. Wider: patches seen more sideways take part
_MIN_PATCHES = 10  # least patches for a pose. More: fewer, surer poses
_NEAREST = 0.1  # [m] least depth in the frame. More: fewer patches
_PRIOR = 1.0  # [1/m^2, 1/rad^2] information at the present pose. It keeps the system solvable, and a patch has about 10^5.
#    More: shorter steps


@dataclass(frozen=True)
class AlignedPatches:
    """N points of a keyframe, and where a frame's image shows them."""

    points: Tensor  # (N, 3) float64 in the keyframe's camera frame [m]
    uv: Tensor  # (N, 2) float64 in the frame's `grey` image [px]
    information: Tensor  # (N, 2, 2) float64, inverse covariance of uv [1/px^2]
    depth: Tensor  # (N,) float64, the frame's depth there [m]
    depth_information: Tensor  # (N,) float64 [1/m^2]; 0: no depth
    camera: Camera  # of the frame's `grey` image

    def __len__(self) -> int:
        return len(self.uv)

    def residuals(self, T_kc: Tensor) -> Tensor:
        """(N,) distances between where the points are seen and where T_kc (4, 4) projects them [standard deviations]."""
        off = self.camera.project(se3.transform(se3.inverse(T_kc), self.points))[0] - self.uv
        return torch.einsum("ni,nij,nj->n", off, self.information, off).clamp(min=0).sqrt()

    def inliers(self, T_kc: Tensor) -> int:
        """The number of points that T_kc (4, 4) projects to where they are seen."""
        return int((self.residuals(T_kc) < _INLIER).sum())

    def agree(self, T_kc: Tensor, T_by_image: Tensor) -> bool:
        """Whether a pose T_kc (4, 4) explains the image about as well as the pose by the image does."""
        return self.inliers(T_kc) >= _AGREEING * self.inliers(T_by_image)

    def distance(self, T_kc: Tensor, other: Tensor) -> float:
        """The median distance [px] between the projections of the points by two poses (4, 4)."""
        a, b = (self.camera.project(se3.transform(se3.inverse(T), self.points))[0] for T in (T_kc, other))
        return float((a - b).norm(dim=-1).median())

    def system(self, T_kc: Tensor, scale: float) -> tuple[Tensor, Tensor]:
        """Normal equations H (6, 6), b (6,) of the projections for exp(delta) T_kc.

        scale: of the robust weights [standard deviations].
        """
        return pick(self.uv, compiled=compiled_projection_system, plain=plain_projection_system)(self, T_kc, scale)


def compiled_projection_system(patches: AlignedPatches, T_kc: Tensor, scale: float) -> tuple[Tensor, Tensor]:
    """`AlignedPatches.system` by Numba, on the CPU."""
    from idfslam.tracking.kernels import numba_patch_alignment

    H, b, c = torch.zeros(6, 6, dtype=torch.float64), torch.zeros(6, dtype=torch.float64), patches.camera
    seen = patches.points, patches.uv, patches.information, patches.depth, patches.depth_information
    arrays = (tensor.contiguous().numpy() for tensor in (se3.inverse(T_kc), *seen))
    numba_patch_alignment.projection_system(*arrays, np.array([c.fx, c.fy, c.cx, c.cy]), scale, H.numpy(), b.numpy())
    return H, b


def plain_projection_system(patches: AlignedPatches, T_kc: Tensor, scale: float) -> tuple[Tensor, Tensor]:
    """`AlignedPatches.system` in torch."""
    T_ck, camera = se3.inverse(T_kc), patches.camera
    moved = se3.transform(T_ck, patches.points)
    uv, z = camera.project(moved)
    off, (x, y) = uv - patches.uv, moved[:, :2].unbind(-1)
    zero = torch.zeros_like(z)
    J_uv = torch.stack([camera.fx / z, zero, -camera.fx * x / z**2, zero, camera.fy / z, -camera.fy * y / z**2], -1).view(-1, 2, 3)
    J_point = T_ck[:3, :3] @ torch.cat([-torch.eye(3).to(T_kc).expand(len(z), 3, 3), se3.hat(patches.points)], -1)
    J, J_z, off_z = J_uv @ J_point, J_point[:, 2], z - patches.depth
    square = torch.einsum("ni,nij,nj->n", off, patches.information, off)
    weight = (z > 0) / (1 + square / scale**2) ** 2
    weight_z = (z > 0) * patches.depth_information / (1 + patches.depth_information * off_z**2 / scale**2) ** 2
    JtW, J_zW = J.mT @ (patches.information * weight[:, None, None]), J_z.T * weight_z
    return (JtW @ J).sum(0) + J_zW @ J_z, -(JtW @ off[..., None]).sum(0)[:, 0] - J_zW @ off_z


@torch.no_grad()
def aligned_patches(T_kc: Tensor, frame: FrameFeatures, keyframe: FrameFeatures) -> tuple[Tensor, AlignedPatches] | None:
    """T_kc (4, 4) float64 by the patches, from a T_kc that is exact to about a pixel of the features; None if too few can be aligned."""
    patches = keyframe.patches
    T_kc = T_kc.cpu().double()
    for level in reversed(range(min(len(frame.pyramid), len(keyframe.pyramid)))):
        aligned = _aligned_on_level(T_kc, patches, frame, keyframe, level)
        if len(aligned) < _MIN_PATCHES:
            return None
        for scale in _SCALES:
            H, b = aligned.system(T_kc, scale)
            T_kc = se3.exp(torch.linalg.solve(H + _PRIOR * torch.eye(6).to(H), b)) @ T_kc
    return se3.orthonormal(T_kc), aligned


def _aligned_on_level(T_kc: Tensor, patches: Patches, frame: FrameFeatures, keyframe: FrameFeatures, level: int) -> AlignedPatches:
    """The patches that are found in the frame on a level of the pyramid, each near where T_kc (4, 4) projects it."""
    to_camera = frame.grey_camera
    uv, warp, visible = _warps(T_kc, patches, keyframe.grey_camera, to_camera)
    patches, uv, warp = patches[visible], uv[visible], warp[visible]
    images = keyframe.pyramid[level], frame.pyramid[level]
    found, H, correlation = align_patches(*images, (patches.uv / 2**level).float(), warp.float(), (uv / 2**level).float())
    good = correlation > _MIN_CORRELATION
    variance = _CORRELATED * 2 * (1 - correlation[good].double()) / (2 * _HALF + 1) ** 2
    floor = _FLOOR**2 * torch.eye(2, dtype=torch.float64)
    covariance = 4**level * (torch.linalg.inv(H[good].double()) * variance[:, None, None] + floor)
    seen = found[good].double() * 2**level
    return AlignedPatches(patches.points[good], seen, torch.linalg.inv(covariance), *_depth_at(seen, frame), to_camera)


def _depth_at(uv: Tensor, frame: FrameFeatures) -> tuple[Tensor, Tensor]:
    """The frame's depth (N,) at pixels `uv` (N, 2) of its `grey` image, and its information (N,)."""
    depth = frame.points[..., 2].cpu().double()
    scale = torch.tensor([depth.shape[1] / frame.grey_camera.width, depth.shape[0] / frame.grey_camera.height])
    u, v = ((uv + 0.5) * scale - 0.5).round().long().clamp(min=0).minimum(torch.tensor([depth.shape[1] - 1, depth.shape[0] - 1])).unbind(-1)
    z = depth[v, u]
    return z, (z > 0) / (_DEPTH_NOISE + difference_noise(z)) ** 2


def _warps(T_kc: Tensor, patches: Patches, camera: Camera, to_camera: Camera) -> tuple[Tensor, Tensor, Tensor]:
    """Where T_kc (4, 4) projects the patches in the frame, uv (N, 2); warps (N, 2, 2) of pixel offsets in the frame to the keyframe.

    The third value (N,) says which patches are seen, without too much stretch.
    """
    T_ck = se3.inverse(T_kc)
    moved = se3.transform(T_ck, patches.points)
    uv, z = to_camera.project(moved)
    steps = torch.eye(2, dtype=torch.float64)
    beside = [to_camera.project(se3.transform(T_ck, patches.on_planes(camera, patches.uv + step)))[0] - uv for step in steps]
    to_frame = torch.stack(beside, -1)
    area = torch.linalg.det(to_frame)
    visible = to_camera.inside(uv, z) & (z > _NEAREST) & (area > _STRETCH[0]) & (area < _STRETCH[1])
    return uv, torch.linalg.inv(torch.where(visible[:, None, None], to_frame, steps)), visible


def align_patches(image: Tensor, to_image: Tensor, uv: Tensor, warp: Tensor, start: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Where patches of `image` (h, w) uint8 lie in `to_image` (h, w) uint8: found (N, 2), H (N, 2, 2), correlation (N,).

    Patch n has its centre at uv[n] of the first image. Its point at the offset warp[n] @ d from the centre lies at the offset d from the
    centre in the second, which is searched from start[n] on. H is the Hessian of half the squared difference of the normalised patches.
    The correlation is -1 where a patch was not found.
    """
    return pick(image, compiled=compiled_align_patches, plain=plain_align_patches)(image, to_image, uv, warp, start)


def compiled_align_patches(image: Tensor, to_image: Tensor, uv: Tensor, warp: Tensor, start: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """`align_patches` by Numba, on the CPU."""
    from idfslam.tracking.kernels import numba_patch_alignment

    found, H, correlation = torch.zeros(len(uv), 2), torch.zeros(len(uv), 3), torch.full((len(uv),), -1.0)
    arrays = (tensor.contiguous().numpy() for tensor in (image, to_image, uv, warp, start))
    limits = np.array([_MAX_SHIFT, _MIN_CONTRAST, _LEAST_TEXTURE, _CONVERGED], np.float32)
    numba_patch_alignment.align_patches(*arrays, _HALF, _ITERATIONS, limits, found.numpy(), H.numpy(), correlation.numpy())
    return found, H[:, [0, 1, 1, 2]].reshape(-1, 2, 2), correlation


def plain_align_patches(image: Tensor, to_image: Tensor, uv: Tensor, warp: Tensor, start: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """`align_patches` in torch."""
    wide = _grid(_HALF + 1)
    values, inside = _sampled(image, uv[:, None] + wide @ warp.mT)
    patch = values.view(-1, 2 * _HALF + 3, 2 * _HALF + 3)
    along_x, along_y = (patch[:, 1:-1, 2:] - patch[:, 1:-1, :-2]) / 2, (patch[:, 2:, 1:-1] - patch[:, :-2, 1:-1]) / 2
    template, contrast = _normalised(patch[:, 1:-1, 1:-1].flatten(1))
    J = torch.stack([along_x.flatten(1), along_y.flatten(1)], -1)
    J = J - J.mean(1, keepdim=True)  # a change of brightness or contrast is no motion: the gradients' parts along 1 and the patch go
    J = (J - template[..., None] * (template[..., None] * J).sum(1, keepdim=True)) / contrast.clamp(min=1e-6)[:, None, None]
    H = J.mT @ J
    textured = torch.linalg.det(H) > _LEAST_TEXTURE * H.diagonal(dim1=-2, dim2=-1).sum(-1) ** 2
    alive = inside & (contrast >= _MIN_CONTRAST * (2 * _HALF + 1)) & textured
    inverse = torch.linalg.inv(torch.where(alive[:, None, None], H, torch.eye(2)))
    found, moving, correlation = start.clone(), alive.clone(), torch.full((len(uv),), -1.0)
    for step in range(_ITERATIONS + 1):
        values, inside = _sampled(to_image, found[:, None] + _grid(_HALF))
        seen, seen_contrast = _normalised(values)
        alive = alive & inside & (seen_contrast > 0)
        difference = seen - template
        now = 1 - difference.square().sum(-1) / 2
        correlation = torch.where(moving, now, correlation)
        if step == _ITERATIONS:
            break
        shift = (inverse @ (J.mT @ difference[..., None]))[..., 0]
        found = torch.where(moving[:, None], found - shift, found)
        alive = alive & ((found - start).abs().amax(-1) <= _MAX_SHIFT)
        moving = moving & alive & (shift.square().sum(-1) >= _CONVERGED**2)
    return found, H, torch.where(alive, correlation, -1.0)


def _grid(half: int) -> Tensor:
    """The offsets (x, y) of the pixels of a square from its centre, (N, 2), row by row."""
    along = torch.arange(-half, half + 1, dtype=torch.float32)
    return torch.stack([along.repeat(len(along)), along.repeat_interleave(len(along))], -1)


def _normalised(values: Tensor) -> tuple[Tensor, Tensor]:
    """Rows (N, M) without their means and of norm 1, and the norms (N,)."""
    centred = values - values.mean(-1, keepdim=True)
    norm = centred.norm(dim=-1)
    return centred / norm.clamp(min=1e-6)[:, None], norm


def _sampled(image: Tensor, uv: Tensor) -> tuple[Tensor, Tensor]:
    """Bilinear values (N, M) of an image at pixels (N, M, 2), and whether all of a row (N,) lie inside."""
    height, width = image.shape
    corner = uv.floor()
    inside = ((uv >= 0) & (corner < torch.tensor([width - 1, height - 1]))).all(-1).all(-1)
    u, v = corner.long().clamp(min=0).minimum(torch.tensor([width - 2, height - 2])).unbind(-1)
    p, q = (uv - corner).unbind(-1)
    rows = image.float()
    top = rows[v, u] * (1 - p) + rows[v, u + 1] * p
    bottom = rows[v + 1, u] * (1 - p) + rows[v + 1, u + 1] * p
    return top * (1 - q) + bottom * q, inside
