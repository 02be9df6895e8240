"""The values of the system: sections, presets, and configurations in YAML files."""

from idfslam.config.config import Config
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
from idfslam.config.presets import FAST, IMAP, NICE, PAPER, PRESETS, PRETRAIN
from idfslam.config.tracking_sections import AlignmentConfig, FinetuneConfig, InverseRenderingConfig, PretrainConfig, TrackerConfig
from idfslam.config.yaml_file import RUN_SECTIONS, as_yaml, check, dump, load, preset, read_yaml, update

__all__ = [
    "FAST",
    "IMAP",
    "NICE",
    "PAPER",
    "PRESETS",
    "PRETRAIN",
    "RUN_SECTIONS",
    "AlignmentConfig",
    "Config",
    "FieldConfig",
    "FinetuneConfig",
    "FusionConfig",
    "InverseRenderingConfig",
    "JointMappingConfig",
    "KeyframeConfig",
    "LoopConfig",
    "MapperConfig",
    "MeshConfig",
    "OccupancyGridsConfig",
    "PretrainConfig",
    "RefinementConfig",
    "TrackerConfig",
    "VolumeDensityConfig",
    "as_yaml",
    "check",
    "dump",
    "load",
    "preset",
    "read_yaml",
    "update",
]
