"""A map that learns while frames are processed: what the rest of the system needs of it, whatever it is made of."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

from idfslam.mapping.surface_field import SurfaceField
from idfslam.sensing.light import Light
from idfslam.storage.state import Stateful


class Map(Stateful, ABC):
    """`learnt` is the field that learns, and `published` what other parts may query meanwhile."""

    field: Any  # SurfaceField that learns
    published: Any  # SurfaceField; a map may say more exactly which
    light: Callable[[Any], Callable[[], Light | None]]  # tells how a frame shows the scene's colours; None: as they are

    @abstractmethod
    def learnt(self) -> SurfaceField:
        """The field learnt so far, published or not."""

    @abstractmethod
    def take_over(self, field: Any) -> None:
        """Continues from another field of the same kind and config."""
