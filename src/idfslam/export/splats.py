"""A surface as 3D Gaussian splats: a flat disc at each vertex, in the PLY files that viewers of splats read (Kerbl et al. 2023).

Their numbers are those before the activations: logarithms of the scales, the logit of the opacity, and colours as the coefficient of the
constant spherical harmonic.
"""

from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from idfslam.export.binary_ply import binary_ply

HARMONIC = 0.28209479177387814  # 1 / (2 sqrt(pi)), the constant spherical harmonic: a fact
_WIDTH = 0.6  # [cells] standard deviation of a disc. More: smoother, softer. Less: gaps between discs. Chosen by hand
_FLATNESS = 0.1  # [1] thickness of a disc over its width. More: silhouettes are thicker. Chosen by hand
_OPACITY = 0.95  # [1] of a disc in its middle. Less: what is behind shines through. Chosen by hand
PROPERTIES = (
    *("x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2"),
    *("rot_0", "rot_1", "rot_2", "rot_3"),
)  # of a splat, all float32; the quaternion has its real part first


def write_splats(path: Path, mesh: trimesh.Trimesh, resolution: float) -> list[Path]:
    """Writes a disc for each vertex of a mesh with vertex colours, whose cells have the edge `resolution` [m], as binary PLY."""
    normals = np.asarray(mesh.vertex_normals)
    count = len(normals)
    colours = np.asarray(mesh.visual.vertex_colors)[:, :3] / 255  # type: ignore[union-attr]
    scales = np.log(_WIDTH * resolution * np.array([1, 1, _FLATNESS]))
    columns = [mesh.vertices, normals, (colours - 0.5) / HARMONIC, np.full((count, 1), np.log(_OPACITY / (1 - _OPACITY)))]
    values = np.concatenate([*columns, np.tile(scales, (count, 1)), _facing(normals)], 1)
    path.write_bytes(binary_ply({name: ("<f4", column) for name, column in zip(PROPERTIES, values.T, strict=True)}))
    return [path]


def _facing(normals: NDArray[np.float64]) -> NDArray[np.float64]:
    """Quaternions (N, 4), real part first, of rotations that bring the z axis to unit normals (N, 3)."""
    side = np.where(np.abs(normals[:, :1]) < 0.9, [[1.0, 0, 0]], [[0, 1.0, 0]])
    x = np.cross(side, normals)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    axes = np.stack([x, np.cross(normals, x), normals], -1)
    return np.roll(Rotation.from_matrix(axes).as_quat(), 1, 1)
