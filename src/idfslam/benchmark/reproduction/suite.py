"""What is run to reproduce the paper: scenes of its tables, methods, and the full system with one part left out at a time."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from idfslam.config import PRESETS, Config, check, preset, update
from idfslam.datasets.recording_path import absolute
from idfslam.errors import ConfigError

RECONSTRUCTION, TRACKING, ABLATION = "reconstruction", "tracking", "ablation"
"""The tables: I and II of Replica's rooms, III of ScanNet's scenes, and ours of left-out parts."""

REPLICA = ("room0", "room1", "room2", "office0", "office1", "office2", "office3", "office4")
SCANNET = ("scene0000_00", "scene0059_00", "scene0106_00", "scene0169_00", "scene0181_00", "scene0207_00")

REDUCED: Mapping[str, Any] = {
    "mapper": {"pixels": 128, "samples": 16, "importance_samples": 8, "first_iterations": 200, "iterations": 30, "pose_iterations": 30},
    "tracker": {"query_stride": 4, "target_stride": 2},
}
"""The paper's preset at a size for a CPU: fewer pixels, samples and steps. All else is as in the paper."""

SMALL: Mapping[str, Mapping[str, Any]] = {
    "paper": REDUCED,
    "imap": {
        "mapper": {"pixels": 60, "samples": 16, "importance_samples": 8, "first_iterations": 150, "learning_rate": 0.001},
        "inverse_rendering": {"pixels": 100},
    },
    "nice": {
        "mapper": {"step_pixels": 200, "samples": 16, "importance_samples": 8, "first_iterations": 150, "iterations": 30},
        "inverse_rendering": {"pixels": 100},
        "keyframes": {"interval": 10},
    },
}
"""What --small changes of each preset, besides the mesh: fewer pixels, samples and steps, so that a frame takes about a second on one core.
iMAP learns faster in its few steps, and NICE-SLAM takes keyframes more often, since at one in 50 frames a short recording has two. A preset
that is not named stays as it is."""

COARSE: Mapping[str, Any] = {"mesh": {"resolution": 0.04}}
"""Cells of all meshes with --small: a network of the paper's size takes longer to ask for cells of 2 cm than for the frames."""

ABLATIONS: Mapping[str, Mapping[str, Any]] = {
    "full": {},
    "no active sampling": {"mapper": {"active_sampling": False}},
    "no replay": {"keyframes": {"replay": 0}},
    "no culling": {"keyframes": {"cull": 1.0}},
    "no pose optimisation": {"mapper": {"pose_optimisation": False}},
    "no 4x4 grid": {"tracker": {"grid": 1}},
    "no finetuning": {"finetune": {"enabled": False}},
}

SMALL_ABLATION: Mapping[str, Any] = {
    "field": {"layers": 4, "width": 128, "skip": 0},
    "mapper": {"pixels": 64, "iterations": 20},
    "finetune": {"keyframes": 4},
}
"""What --small changes further where parts are left out. Wide steps around the whole room give keyframes that are not connected, so that
replay acts; finetuning begins with the fourth keyframe, since a tour keeps fewer than the ten that it waits for."""


@dataclass(frozen=True)
class TableScene:
    """A recording of a table."""

    name: str
    path: str
    table: str
    frames: int | None = None  # None: all
    stride: int = 1
    gt_mesh: Path | None = None  # None: a generated recording computes its own, and others have none


@dataclass(frozen=True)
class Job:
    """A run: a method on a scene, perhaps with a part left out."""

    scene: TableScene
    method: str  # a preset
    variant: str = ""  # which part is left out; empty: none is asked about
    values: Mapping[str, Any] = field(default_factory=dict)  # over those of the preset

    @property
    def name(self) -> str:
        """The name of its result folder."""
        return "-".join(word.replace(" ", "-") for word in (self.scene.name, self.method, self.variant) if word)

    def config(self, seed: int, device: str) -> Config:
        """All values of the run. Raises ConfigError if they cannot work together."""
        return check(update(preset(self.method), {**_merged(self.values), "seed": seed, "device": device}, "reproduce"))


@dataclass(frozen=True)
class Suite:
    """All runs, with what is said about them on the page."""

    jobs: tuple[Job, ...]
    small: bool
    notes: tuple[str, ...]


def methods_of(given: Sequence[str] | None) -> list[str]:
    """The presets to compare, in the order of the page. None: all. Raises ConfigError for an unknown one, and without any."""
    if given is not None and not given:
        raise ConfigError(f"--methods: expected some of {', '.join(PRESETS)} behind it")
    if unknown := [name for name in given or () if name not in PRESETS]:
        raise ConfigError(f"--methods {unknown[0]}: no such preset, expected some of {', '.join(PRESETS)}")
    order = [name for name in ("imap", "nice", "paper", "fast") if name in PRESETS]
    return [name for name in order + [n for n in PRESETS if n not in order] if name in (given or PRESETS)]


def small_suite(methods: Sequence[str], *, ablations: bool) -> Suite:
    """Generated rooms alone, at sizes for a CPU."""
    scenes = [
        TableScene("synthetic-0", "synthetic:0", RECONSTRUCTION, frames=80),
        TableScene("synthetic-1-kinect", "synthetic:1:kinect", TRACKING, frames=80),
    ]
    jobs = [Job(scene, method, values=_merged(SMALL.get(method, {}), COARSE)) for scene in scenes for method in methods]
    if ablations:
        tour = TableScene("synthetic-0-tour", "synthetic:0", ABLATION, frames=75, stride=8)
        jobs += _ablations(tour, [REDUCED, SMALL_ABLATION, COARSE])
    notes = (
        "Reduced sizes and short, generated recordings: the order of the methods may differ from that at full size.",
        "Tables I to III are of 80 frames of a slow walk, in which the paper's culling leaves one keyframe: replay and finetuning act "
        "where one part is left out at a time, in a whole tour of the room.",
        "The protocol counts all surface within the views, also what other things hide, so no method completes all of it.",
    )
    return Suite(tuple(jobs), True, notes)


def full_suite(data: Path, methods: Sequence[str], *, ablations: bool) -> Suite:
    """The paper's own sequences where `data` has them, and generated rooms where not; all values as published."""
    data = absolute(data)  # processes on other nodes have folders of their own
    replica = [scene for name in REPLICA if (scene := _replica(data, name)) is not None]
    scannet = [scene for name in SCANNET if (scene := _scannet(data, name)) is not None]
    notes = []
    if not replica:
        replica = [TableScene(f"synthetic-{seed}", f"synthetic:{seed}", RECONSTRUCTION) for seed in range(3)]
        notes.append(f"Tables I and II are of generated rooms: {data} has no Replica (`idf-slam download replica --out {data}`).")
    if not scannet:
        scannet = [TableScene(f"synthetic-{seed}-kinect", f"synthetic:{seed}:kinect", TRACKING) for seed in range(3)]
        notes.append(
            f"Table III is of generated rooms with a Kinect's noise: {data} has none of ScanNet's six scenes (its authors give access)."
        )
    jobs = [Job(scene, method) for scene in (*replica, *scannet) for method in methods]
    if ablations:
        first = replica[0]
        jobs += _ablations(TableScene(f"{first.name}-ablation", first.path, ABLATION, gt_mesh=first.gt_mesh), [])
    return Suite(tuple(jobs), False, tuple(notes))


def _ablations(scene: TableScene, common: Sequence[Mapping[str, Any]]) -> Iterator[Job]:
    for variant, change in ABLATIONS.items():
        yield Job(scene, "paper", variant, _merged(*common, change))


def _replica(data: Path, name: str) -> TableScene | None:
    folder = next((place / name for place in (data / "Replica", data) if (place / name / "traj.txt").is_file()), None)
    if folder is None:
        return None
    meshes = (folder / "gt_mesh.ply", folder.parent / f"{name}_mesh.ply")
    return TableScene(name, str(folder), RECONSTRUCTION, gt_mesh=next((mesh for mesh in meshes if mesh.is_file()), None))


def _scannet(data: Path, name: str) -> TableScene | None:
    places = (data / "scannet" / name, data / "ScanNet" / name, data / name)
    folder = next((place for place in places if place.is_dir()), None)
    return None if folder is None else TableScene(name, str(folder), TRACKING)


def _merged(*changes: Mapping[str, Any]) -> dict[str, Any]:
    """Nested values, later ones over earlier ones."""
    merged: dict[str, Any] = {}
    for change in changes:
        for key, value in change.items():
            merged[key] = _merged(merged.get(key, {}), value) if isinstance(value, Mapping) else value
    return merged
