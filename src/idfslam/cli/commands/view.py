"""`idf-slam view`."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from idfslam.viewer.rerun_program import LOOPBACK, PORT

if TYPE_CHECKING:
    from rich.console import Console


@dataclass(frozen=True)
class View:
    """Open the recorded live view of a run."""

    folder: Positional[Path]
    """Result folder."""
    web: bool = False
    """Show it in a browser instead of a window. Without a display this is the default."""
    port: int = PORT
    """Port of the page of --web. Data is served on PORT+1."""
    host: str = LOOPBACK
    """Address of this machine that --web listens on. 0.0.0.0 opens it to the network, without a password."""

    def __call__(self, console: "Console") -> None:
        from idfslam.viewer.recorded_view import show
        from idfslam.viewer.rerun_program import has_display

        show(self.folder, web=self.web or not has_display(), port=self.port, host=self.host)
