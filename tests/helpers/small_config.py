"""The default system in small, for runs on the box recording."""

from dataclasses import replace

from idfslam.config import FAST, Config


def small() -> Config:
    """The default system with few samples."""
    return replace(
        FAST,
        field=replace(FAST.field, table_log2=13),
        refinement=replace(FAST.refinement, updates=2),
        mapper=replace(FAST.mapper, pixels=256, first_iterations=200),
        keyframes=replace(FAST.keyframes, translation=0.05, rotation=5.0, cull=1.0),
        alignment=replace(FAST.alignment, points=1500, landmarks=1000, image_height=120, image_levels=2),
    )
