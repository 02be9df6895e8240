"""`idf-slam view`."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

if TYPE_CHECKING:
    from rich.console import Console


@dataclass(frozen=True)
class View:
    """The recorded live view of a run, to be looked at again and again."""

    folder: Positional[Path]
    """The result folder."""
    web: bool = False
    """Serve it to a browser instead of opening a window; without a display that is done anyway."""
    port: int = 9090
    """Of the page; the data come from the next one."""

    def __call__(self, console: "Console") -> None:
        from idfslam.viewer.rerun_program import has_display
        from idfslam.viewer.rerun_viewer import show

        show(self.folder, web=self.web or not has_display(), port=self.port)
