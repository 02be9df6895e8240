"""Splats of a surface: what other programs read."""

from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from idfslam.export.splats import HARMONIC, PROPERTIES, write_splats


def test_discs_lie_on_the_surface_in_its_colours(tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(3, 0.5)
    colours = np.random.default_rng(0).integers(0, 256, (len(ball.vertices), 4)).astype(np.uint8)
    ball.visual.vertex_colors = colours
    (path,) = write_splats(tmp_path / "splats.ply", ball, 0.02)
    read = trimesh.load(path, process=False)
    data = read.metadata["_ply_raw"]["vertex"]["data"]
    assert data.dtype.names == PROPERTIES
    columns = {name: np.asarray(data[name], np.float64).ravel() for name in PROPERTIES}
    np.testing.assert_allclose(np.stack([columns[name] for name in "xyz"], 1), ball.vertices, atol=1e-6)
    shown = np.stack([columns[f"f_dc_{i}"] for i in range(3)], 1) * HARMONIC + 0.5
    np.testing.assert_allclose(shown * 255, colours[:, :3], atol=1e-3)
    np.testing.assert_allclose(np.exp(columns["scale_0"]), 0.012, rtol=1e-5)
    np.testing.assert_allclose(np.exp(columns["scale_2"]), 0.0012, rtol=1e-5)
    np.testing.assert_allclose(1 / (1 + np.exp(-columns["opacity"])), 0.95, rtol=1e-5)
    quaternions = np.stack([columns[f"rot_{i}"] for i in (1, 2, 3, 0)], 1)  # scipy has the real part last
    np.testing.assert_allclose(Rotation.from_quat(quaternions).as_matrix()[..., 2], ball.vertex_normals, atol=1e-6)
