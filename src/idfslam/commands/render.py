"""`idf-slam render`."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

if TYPE_CHECKING:
    from rich.console import Console


@dataclass(frozen=True)
class Render:
    """Colour and depth pictures of a saved map, seen from frames of the trajectory."""

    folder: Positional[Path]
    """The result folder."""
    frames: tuple[int, ...] = ()
    """Which frames; none given: the keyframes."""
    out: Path | None = None
    """Where the pictures go; none given: render/ in the result folder."""

    def __call__(self, console: "Console") -> None:
        from idfslam.saved import write_views

        print(*write_views(self.folder, self.out, frames=self.frames), sep="\n")
