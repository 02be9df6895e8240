"""Every value of the system with its unit, effect and source; one section a component, in `map_sections`, `tracking_sections` and
`keyframe_sections`.

`UserOption` marks the values that `--help` shows. Sections and equations are those of the paper; a page of docs/ that is named holds the
measurement. The error of a recording is the RMS error of its trajectory (ATE) unless accuracy or surface is mentioned. For a value without
a source no measurement is kept.
"""

# ruff: noqa: RUF009 (the defaults are frozen)

from dataclasses import dataclass
from typing import Literal

from idfslam.config.fields import EveryNth, Positive, UserOption
from idfslam.config.keyframe_sections import KeyframeConfig, LoopConfig, RefinementConfig
from idfslam.config.map_sections import (
    FieldConfig,
    FusionConfig,
    JointMappingConfig,
    MapperConfig,
    MeshConfig,
    OccupancyGridsConfig,
    VolumeDensityConfig,
)
from idfslam.config.tracking_sections import AlignmentConfig, FinetuneConfig, InverseRenderingConfig, TrackerConfig


@dataclass(frozen=True)
class Config:
    """All values of a run."""

    preset: UserOption[Literal["fast", "paper", "imap", "nice"]] = "fast"
    """Set of values to start from: `fast` for use, `paper` for the values of the paper (Sec. VI-A), `imap` and `nice` for those of iMAP and
    NICE-SLAM, in our implementations (docs/presets.md). Other options change single values."""
    seed: UserOption[int] = 0
    """Seed of every random choice."""
    device: UserOption[Literal["auto", "cpu", "cuda"]] = "auto"
    """Device that the networks run on. `auto` takes the CPU for the preset `fast`, which was never run on a GPU,
    and a GPU if there is one for `paper`."""
    front_end: str = "alignment"
    """The part that tracks frames. `alignment` aligns every frame to the map and uses the neural tracker where the result is in doubt.
    `registration` uses the neural tracker alone, as in the paper. `inverse_rendering` moves the pose until the rendered map shows the
    frame, as iMAP and NICE-SLAM do."""
    map_representation: str = "neural_field"
    """The part that is the map. `neural_field` is one network of T-SDF and colour, as in the paper. `volume_density` is iMAP's map, and
    `occupancy_grids` NICE-SLAM's."""
    back_end: str = "keyframe_mapping"
    """The part that maps. `keyframe_mapping` trains the map on each keyframe and on replayed ones, as in the paper. `joint_mapping`
    optimises the map and the poses of a window together, as iMAP and NICE-SLAM do."""
    refine: UserOption[bool] = True
    """Refine all keyframe poses and the map together after the last frame."""
    calibrate: UserOption[Literal["off", "warn", "on"]] = "warn"
    """Whether the camera is checked. `warn` says so where the views show that it is not as stated. `on` first calibrates it from the whole
    recording (`idf-slam calibrate`), and then runs with what was found, which takes twice as long."""
    archive: UserOption[bool] = True
    """Keep images of the recording beside the map (archive.safetensors), which views, videos and the colours of meshes are made of."""
    archive_megabytes: Positive = 20.0
    """Size of that archive [MB] at most. A room takes 20; in larger scenes more is sharper away from the few images that are left."""
    hold_out: EveryNth = 0
    """Keep every N-th frame from the map, the keyframes and the archive of images, so that `idf-slam eval --views` can compare it with the
    rendered view; it is tracked like any other. 0: none."""
    movers: UserOption[Literal["mask", "off"]] = "mask"
    """What moves before the camera (people, doors, things that are carried). `mask` finds it by the free space that earlier views saw, and
    leaves it out of tracking and of the map. `off` takes everything for static."""
    field: FieldConfig = FieldConfig()
    mapper: MapperConfig = MapperConfig()
    keyframes: KeyframeConfig = KeyframeConfig()
    tracker: TrackerConfig = TrackerConfig()
    finetune: FinetuneConfig = FinetuneConfig()
    alignment: AlignmentConfig = AlignmentConfig()
    refinement: RefinementConfig = RefinementConfig()
    loops: LoopConfig = LoopConfig()
    fusion: FusionConfig = FusionConfig()
    mesh: MeshConfig = MeshConfig()
    volume_density: VolumeDensityConfig = VolumeDensityConfig()
    occupancy_grids: OccupancyGridsConfig = OccupancyGridsConfig()
    joint_mapping: JointMappingConfig = JointMappingConfig()
    inverse_rendering: InverseRenderingConfig = InverseRenderingConfig()
