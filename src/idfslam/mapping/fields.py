"""The kinds of fields by their names in files of maps: the section of the configuration that each is made from, and its class."""

from typing import Any

from idfslam.config import FieldConfig, OccupancyGridsConfig, VolumeDensityConfig
from idfslam.mapping.field import Field
from idfslam.mapping.joint.occupancy_grids import OccupancyGrids
from idfslam.mapping.joint.volume_density import VolumeDensity
from idfslam.mapping.surface_field import SurfaceField

FIELDS: dict[str, tuple[Any, type[Any]]] = {
    Field.representation: (FieldConfig, Field),
    VolumeDensity.representation: (VolumeDensityConfig, VolumeDensity),
    OccupancyGrids.representation: (OccupancyGridsConfig, OccupancyGrids),
}


def make_field(representation: str, config: Any) -> SurfaceField:
    """A field of a kind, with its first weights. Raises KeyError for an unknown kind."""
    field: SurfaceField = FIELDS[representation][1](config)
    return field
