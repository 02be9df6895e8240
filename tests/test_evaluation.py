"""The record of an evaluation as JSON."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from idfslam.evaluation.evaluate import evaluate_poses
from idfslam.evaluation.mesh_error import MeshError


def test_json_holds_null_for_what_is_not_finite_and_is_written_whole(tmp_path: Path) -> None:
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, 0, 3] = [0, 1, 3]
    mesh = MeshError(
        "nice", 0.0, np.inf, "protocol", 0.01, 0.02, 0.9, 0.8, 0.7, 0.75, 2.0, float("nan"), None, samples=10, views=1, icp_shift=0.0
    )
    replace(evaluate_poses(poses, poses), mesh=mesh).save(tmp_path / "evaluation.json")

    def refuse(constant: str) -> None:
        raise AssertionError(constant)

    written = json.loads((tmp_path / "evaluation.json").read_text(), parse_constant=refuse)
    assert (written["mesh"]["far"], written["mesh"]["depth_l1"], written["mesh"]["accuracy"]) == (None, None, 0.01)
    assert (written["frames"], written["ate_m"]["max"] < 1e-9, list(written)[5:]) == (3, True, ["rpe_1", "jump", "mesh"])
    assert written["schema"] == 1
    assert [path.name for path in tmp_path.iterdir()] == ["evaluation.json"]
