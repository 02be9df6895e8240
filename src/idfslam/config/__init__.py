"""The values of the system: sections, presets, and configurations in YAML files."""

from idfslam.config.presets import FAST, PAPER, PRESETS, PRETRAIN
from idfslam.config.sections import (
    AlignmentConfig,
    Config,
    FieldConfig,
    FinetuneConfig,
    KeyframeConfig,
    LoopConfig,
    MapperConfig,
    MeshConfig,
    PretrainConfig,
    RefinementConfig,
    TrackerConfig,
)
from idfslam.config.yaml_file import RUN_SECTIONS, check, dump, load, preset, read_yaml, update

__all__ = [
    "FAST",
    "PAPER",
    "PRESETS",
    "PRETRAIN",
    "RUN_SECTIONS",
    "AlignmentConfig",
    "Config",
    "FieldConfig",
    "FinetuneConfig",
    "KeyframeConfig",
    "LoopConfig",
    "MapperConfig",
    "MeshConfig",
    "PretrainConfig",
    "RefinementConfig",
    "TrackerConfig",
    "check",
    "dump",
    "load",
    "preset",
    "read_yaml",
    "update",
]
