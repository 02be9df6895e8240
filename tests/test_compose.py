"""Which parts a configuration is turned into, parts of one's own, and what a Slam leaves as it was."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest
import torch

from helpers.box_room import BOX_FRAMES, box_poses
from helpers.small_config import small
from idfslam.config import FAST, PAPER, PRESETS, Config
from idfslam.datasets import open_recording
from idfslam.errors import ConfigError
from idfslam.frame import Status
from idfslam.graph.keyframe import Keyframe
from idfslam.mapping.mapper import Mapper
from idfslam.mapping.updates import InBackground, InTurns
from idfslam.slam import BackEnd, FrontEnd, Slam, Source, System, Tracked
from idfslam.slam.back_end.back_end import KeyframeMapping
from idfslam.slam.back_end.finetuner import Finetuner, NoFinetuning
from idfslam.slam.back_end.keyframe_pose import KeyframeRegistration, PoseOptimisation, TrackedPose
from idfslam.slam.back_end.light_estimation import LightEstimation
from idfslam.slam.back_end.polish import NoPolish, Polish
from idfslam.slam.back_end.refinement import KeyframeRefinement, NoRefinement
from idfslam.slam.front_end.alignment_to_map import AlignmentToMap
from idfslam.slam.front_end.registration import Registration
from idfslam.slam.keyframe_adjustment.camera_check import CameraCheck
from idfslam.slam.keyframe_adjustment.local_adjustment import LocalAdjustment
from idfslam.slam.place_recognition.loop_closer import LoopCloser
from idfslam.slam.place_recognition.recovery import NoRecovery, Relocalisation
from idfslam.slam.place_recognition.relocalisation_check import RelocalisationCheck
from idfslam.slam.place_recognition.submap_merger import SubmapMerger


def classes(config: Config) -> dict[str, Any]:
    """The class of each part."""
    system = System(config)
    names = "front_end", "back_end", "mapper", "recovery", "keyframe_pose", "refinement", "polish", "finetuner"
    one = {name: type(getattr(system, name)) for name in names}
    return {**one, "updates": type(system.mapper.updates), "hooks": [type(hook) for hook in system.hooks]}


def test_the_parts_of_the_fast_preset() -> None:
    assert classes(FAST) == {
        "front_end": AlignmentToMap,
        "back_end": KeyframeMapping,
        "mapper": Mapper,
        "recovery": Relocalisation,
        "keyframe_pose": KeyframeRegistration,
        "refinement": KeyframeRefinement,
        "polish": Polish,
        "finetuner": Finetuner,
        "updates": InBackground,
        "hooks": [LightEstimation, RelocalisationCheck, LocalAdjustment, LoopCloser, SubmapMerger, CameraCheck],
    }


def test_the_parts_of_the_paper_preset() -> None:
    assert classes(PAPER) == {
        "front_end": Registration,
        "back_end": KeyframeMapping,
        "mapper": Mapper,
        "recovery": NoRecovery,
        "keyframe_pose": PoseOptimisation,
        "refinement": NoRefinement,
        "polish": NoPolish,
        "finetuner": Finetuner,
        "updates": InTurns,
        "hooks": [],
    }


@pytest.mark.parametrize(
    ("changes", "parts"),
    [
        ({"refine": False}, {"polish": NoPolish, "refinement": KeyframeRefinement}),
        ({"finetune": replace(FAST.finetune, enabled=False)}, {"finetuner": NoFinetuning}),
        (
            {"loops": replace(FAST.loops, enabled=False)},
            {"hooks": [LightEstimation, RelocalisationCheck, LocalAdjustment, CameraCheck], "recovery": Relocalisation},
        ),
        (
            {"loops": replace(FAST.loops, relocalise=False)},
            {"hooks": [LightEstimation, LocalAdjustment, LoopCloser, SubmapMerger, CameraCheck], "recovery": NoRecovery},
        ),
        (
            {"mapper": replace(FAST.mapper, light=False)},
            {"hooks": [RelocalisationCheck, LocalAdjustment, LoopCloser, SubmapMerger, CameraCheck]},
        ),
        ({"calibrate": "off"}, {"hooks": [LightEstimation, RelocalisationCheck, LocalAdjustment, LoopCloser, SubmapMerger]}),
        ({"mapper": replace(FAST.mapper, background=False)}, {"updates": InTurns}),
        (
            {"front_end": "registration"},
            {
                "recovery": NoRecovery,
                "hooks": [LightEstimation, CameraCheck],
                "keyframe_pose": TrackedPose,
                "refinement": NoRefinement,
                "front_end": Registration,
            },
        ),
    ],
)
def test_what_a_value_changes(changes: dict[str, Any], parts: dict[str, Any]) -> None:
    changed = classes(replace(FAST, **changes))
    assert {name: part for name, part in changed.items() if part != classes(FAST)[name]}.items() <= parts.items()
    assert parts.items() <= changed.items()


@pytest.mark.parametrize(
    ("key", "names"),
    [
        ("front_end", "alignment, registration, inverse_rendering"),
        ("map_representation", "neural_field, volume_density, occupancy_grids"),
        ("back_end", "keyframe_mapping, joint_mapping"),
    ],
)
def test_an_unknown_part_ends_in_one_line(key: str, names: str) -> None:
    with pytest.raises(ConfigError) as caught:
        Slam(replace(FAST, **{key: "guessing"}))
    assert str(caught.value) == f"{key} 'guessing', expected one of {names}"


@pytest.mark.parametrize("preset", ["imap", "nice"])
def test_alignment_to_a_map_without_signed_distance_ends_in_one_line(preset: str) -> None:
    with pytest.raises(ConfigError, match="expected neural_field: frames are aligned to a signed distance; choose front_end") as caught:
        Slam(replace(PRESETS[preset], front_end="alignment", device="cpu"))
    assert "\n" not in str(caught.value)


def true_poses() -> np.ndarray:
    """(N, 4, 4) in the camera of the first frame."""
    return np.linalg.inv(box_poses()[0]) @ box_poses()


class KnowingFrontEnd(FrontEnd):
    """Knows the box recording's poses."""

    def __init__(self, system: System) -> None:
        self.tracked: list[int] = []

    def track(self, view: Keyframe) -> Tracked:
        self.tracked.append(view.index)
        return Tracked(torch.from_numpy(true_poses()[view.index]), Status.OK, Source.REGISTERED)


def processed(recording: Path, **parts: Callable[[System], Any]) -> tuple[Slam, list[Any]]:
    data, slam = open_recording(recording), Slam(small(), **parts)
    return slam, [slam.process(data[i]) for i in range(len(data))]


def test_a_front_end_of_ones_own(box_recording: Path) -> None:
    slam, results = processed(box_recording, front_end=KnowingFrontEnd)
    assert isinstance(slam.front_end, KnowingFrontEnd)
    assert slam.front_end.tracked == list(range(1, BOX_FRAMES))  # the first frame is the world
    assert [r.status for r in results] == [Status.OK] * BOX_FRAMES
    assert slam.figures()["relocalisations"] == 0
    keyframes = [r.index for r in results if r.keyframe]
    assert len(keyframes) >= 3
    for result in results:  # a keyframe's pose is refined
        np.testing.assert_allclose(result.T_wc, true_poses()[result.index], atol=0.01 if result.keyframe else 1e-9)
    slam.finish()
    assert np.abs(slam.trajectory()[:, :3, 3] - true_poses()[:, :3, 3]).max() < 0.01


class CountingBackEnd(BackEnd):
    """Stores keyframes and maps nothing."""

    def __init__(self, system: System) -> None:
        self.graph, self.frames = system.graph, system.frames

    def add_keyframe(self, keyframe: Keyframe, tracked: Tracked) -> dict[str, float]:
        self.graph.insert(keyframe)
        self.frames.attach_last(keyframe)
        return {"stored": float(len(self.graph.keyframes))}


def test_a_back_end_of_ones_own(box_recording: Path) -> None:
    slam, results = processed(box_recording, front_end=KnowingFrontEnd, back_end=CountingBackEnd)
    assert [r.losses for r in results if r.keyframe] == [{"stored": i + 1.0} for i in range(len(slam.graph.keyframes))]
    assert all(r.losses == {} for r in results if not r.keyframe)
    np.testing.assert_allclose(slam.trajectory(), true_poses(), atol=1e-9)
    slam.finish()
    assert slam.loops() == ()


def test_a_map_of_ones_own() -> None:
    made: list[Mapper] = []

    def smaller(system: System) -> Mapper:
        field = replace(system.config.field, table_log2=8)
        made.append(Mapper(system.config.mapper, field, system.device, torch.Generator().manual_seed(0), InTurns()))
        return made[0]

    slam = Slam(small(), map=smaller)
    assert made == [slam.mapper]


def test_each_part_is_made_once_and_shared() -> None:
    system = System(FAST)
    assert system.relocaliser is system.recovery.relocaliser is system.keyframe_pose.relocaliser  # type: ignore[attr-defined]
    assert system.aligner is system.relocaliser.aligner is system.front_end.aligner  # type: ignore[attr-defined]
    assert system.hooks[1] is system.recovery.check  # type: ignore[attr-defined]
    assert system.back_end.updates.mapper is system.mapper  # type: ignore[attr-defined]


def settings() -> tuple[list[int], int, int, bool]:
    """Those of the process that a system could change for everything else in it."""
    state = torch.random.get_rng_state().tolist()
    return state, torch.get_num_threads(), numba.get_num_threads(), torch.are_deterministic_algorithms_enabled()


@pytest.mark.parametrize("preset", [FAST, PAPER], ids=["fast", "paper"])
def test_making_a_system_leaves_the_process_as_it_was(preset: Config) -> None:
    before = settings()
    Slam(preset)
    assert settings() == before


def test_running_a_system_leaves_the_process_as_it_was(box_recording: Path) -> None:
    before = settings()
    slam, _ = processed(box_recording)
    assert settings() == before
    slam.finish()
    assert settings() == before


def test_first_weights_come_from_the_seed_alone() -> None:
    torch.manual_seed(1)
    first = Slam(small()).mapper.field.state_dict()
    torch.manual_seed(2)
    second = Slam(small()).mapper.field.state_dict()
    other = Slam(replace(small(), seed=5)).mapper.field.state_dict()
    assert all(torch.equal(value, second[name]) for name, value in first.items())
    assert not all(torch.equal(value, other[name]) for name, value in first.items())
