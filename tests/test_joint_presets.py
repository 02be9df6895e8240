"""`--preset imap` and `--preset nice` in small, from the first frame to the mesh, saved maps and checkpoints."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from helpers.box_room import BOX, box_poses, write_box_recording
from helpers.differences import differences
from idfslam.config import IMAP, NICE, Config
from idfslam.datasets import open_recording
from idfslam.errors import ConfigError
from idfslam.frame import FrameResult
from idfslam.graph.information_gain import InformationGain
from idfslam.graph.keyframe_interval import KeyframeInterval
from idfslam.mapping.field import copy_of
from idfslam.mapping.joint.density_map import DensityMap
from idfslam.mapping.joint.grids_map import GridsMap
from idfslam.mapping.saved_map import load_map
from idfslam.runs.checkpoint import Checkpoints
from idfslam.slam import Slam
from idfslam.slam.back_end.joint_mapping import JointMapping
from idfslam.slam.back_end.mapping_window import LossWindow, OverlapWindow
from idfslam.slam.compose import System
from idfslam.slam.front_end.inverse_rendering import InverseRendering
from idfslam.storage.state import State


def small_imap() -> Config:
    return replace(
        IMAP,
        device="cpu",
        volume_density=replace(IMAP.volume_density, width=64),
        mapper=replace(
            IMAP.mapper, pixels=64, samples=16, importance_samples=8, first_iterations=300, iterations=15, every=2, learning_rate=2e-3
        ),
        keyframes=replace(IMAP.keyframes, explained=0.99),
        inverse_rendering=replace(IMAP.inverse_rendering, pixels=100, iterations=20, learning_rate=3e-3),
    )


def small_nice() -> Config:
    return replace(
        NICE,
        device="cpu",
        occupancy_grids=replace(NICE.occupancy_grids, table_log2=11, refinement_rounds=1),
        mapper=replace(NICE.mapper, step_pixels=160, samples=12, importance_samples=8, first_iterations=300, iterations=15, every=2),
        keyframes=replace(NICE.keyframes, interval=3),
        joint_mapping=replace(NICE.joint_mapping, poses_from=2),
        inverse_rendering=replace(NICE.inverse_rendering, pixels=100, iterations=20, learning_rate=3e-3),
    )


TILT = 20.0  # [degrees] down, so that the camera sees the floor: with two walls alone, depth leaves the height open
BOX_POSE = box_poses(TILT)[0]
SMALL = {"imap": small_imap, "nice": small_nice}


@pytest.mark.parametrize(
    ("config", "map", "keyframes", "window"),
    [(IMAP, DensityMap, InformationGain, LossWindow), (NICE, GridsMap, KeyframeInterval, OverlapWindow)],
    ids=["imap", "nice"],
)
def test_the_parts(config: Config, map: type, keyframes: type, window: type) -> None:
    system = System(replace(config, device="cpu"))
    parts = [system.map, system.front_end, system.back_end, system.keyframe_selection, system.mapping_window]
    assert [type(part) for part in parts] == [map, InverseRendering, JointMapping, keyframes, window]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"map_representation": "neural_field"},
            "'neural_field', expected volume_density or occupancy_grids for front_end",
        ),
        (
            {"back_end": "keyframe_mapping"},
            "'volume_density', expected neural_field for front_end 'inverse_rendering' and",
        ),
    ],
)
def test_parts_that_do_not_fit_end_in_one_line(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        Slam(replace(IMAP, device="cpu", **changes))


class Run:
    """A small run, with a checkpoint that another Slam went on from half way."""

    def __init__(self, config: Config, recording: Path, folder: Path) -> None:
        data = open_recording(recording)
        self.slam, self.truth = Slam(config), np.linalg.inv(data.ground_truth[0]) @ data.ground_truth
        self.results: list[FrameResult] = []
        self.lost: list[str] = []
        again: Slam | None = None
        with Checkpoints(folder, {}) as checkpoints:
            for i in range(len(data)):
                self.results.append(self.slam.process(data[i]))
                if again is not None:
                    again.process(data[i])
                if i == 7:
                    again = Slam(config)
                    again.restore(read_back(checkpoints, self.slam.state()), lambda k: data[k])
                    self.lost = list(differences(self.slam, again, "slam"))
        assert again is not None
        self.slam.finish()
        again.finish()
        self.again = again


def read_back(checkpoints: Checkpoints, state: State) -> State:
    checkpoints.save(1, state)
    checkpoints.wait()
    read = checkpoints.read()
    assert read is not None
    return read


@pytest.fixture(scope="module", params=list(SMALL))
def finished(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Run:
    make: Callable[[], Config] = SMALL[request.param]
    recording = write_box_recording(tmp_path_factory.mktemp("recordings") / "box", tilt=TILT)
    return Run(make(), recording, tmp_path_factory.mktemp("checkpoint"))


@pytest.mark.slow
def test_they_follow_the_camera(finished: Run) -> None:
    assert {r.status.value for r in finished.results} == {"ok"}
    errors = np.linalg.norm(finished.slam.trajectory()[:, :3, 3] - finished.truth[:, :3, 3], axis=-1)
    assert errors[:10].max() < 0.05, errors  # of 15 cm, by so few pixels and steps; then pixels that were never seen draw the pose away
    assert sum(r.keyframe for r in finished.results) == len(finished.slam.graph.keyframes) >= 2


@pytest.mark.slow
def test_losses_are_told(finished: Run) -> None:
    assert set(finished.results[0].losses) == {"photometric", "depth", "total"}
    assert all(math.isfinite(value) for r in finished.results for value in r.losses.values())


@pytest.mark.slow
def test_the_mesh_lies_on_the_walls(finished: Run) -> None:
    mesh = finished.slam.mesh(0.05)
    world = mesh.vertices @ BOX_POSE[:3, :3].T + BOX_POSE[:3, 3]
    distance = np.abs(np.abs(world) - BOX).min(1)  # to the nearest of the six planes
    assert len(mesh.vertices) > 300
    assert np.median(distance) < 0.06


@pytest.mark.slow
def test_the_map_is_saved_and_read(finished: Run, tmp_path: Path) -> None:
    finished.slam.save_map(tmp_path / "map.safetensors")
    loaded, field = load_map(tmp_path / "map.safetensors"), copy_of(finished.slam.mapper.learnt())
    field.bf16 = False  # as a saved map is computed: where the processor multiplies bf16, that alone makes 0.035
    assert type(loaded.field) is type(field)
    assert loaded.field.config == field.config
    points = torch.rand(500, 3, generator=torch.Generator().manual_seed(0)) - 0.5
    with torch.no_grad():
        torch.testing.assert_close(loaded.field.sdf(points), field.sdf(points), atol=0.005, rtol=0)  # 16-bit tables
    camera = finished.slam.graph.keyframes[0].camera
    colour, depth = loaded.render(np.eye(4), camera.resized(40, 30))
    assert colour.shape == (30, 40, 3)
    assert (depth > 0).mean() > 0.5


@pytest.mark.slow
def test_nothing_is_forgotten(finished: Run) -> None:
    assert finished.lost == []


@pytest.mark.slow
def test_a_restored_run_ends_as_the_unbroken_one(finished: Run) -> None:
    assert np.array_equal(finished.slam.trajectory(), finished.again.trajectory())
    mine, other = (slam.mapper.learnt().state_dict() for slam in (finished.slam, finished.again))
    assert all(torch.equal(value, other[name]) for name, value in mine.items())
