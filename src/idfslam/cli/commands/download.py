"""`idf-slam download`."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from idfslam.cli.commands.command import output
from idfslam.cli.plain_text import plain_printer

if TYPE_CHECKING:
    from rich.console import Console


@dataclass(frozen=True)
class Download:
    """Download a public sequence of TUM RGB-D, Bonn, 7-Scenes, ICL-NUIM or Replica.

    It comes from its authors' server. An interrupted download continues where it stopped.
    """

    name: Positional[str] = ""
    """Name of the sequence, such as tum-fr1-desk. --list shows all names."""
    out: Path = Path("data")
    """Folder of downloads. The sequence becomes a folder in it."""
    listing: Annotated[bool, arg(name="list")] = False
    """Show all names, with their sizes and terms."""

    def __call__(self, console: "Console") -> None:
        from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TimeRemainingColumn, TransferSpeedColumn

        from idfslam.cli.tables import print_catalogue
        from idfslam.downloads.catalogue import catalogue, find_sequence
        from idfslam.downloads.download import download
        from idfslam.errors import ConfigError

        if self.listing:
            print_catalogue(catalogue().values(), output())
            return
        if not self.name:
            raise ConfigError("download: expected the name of a sequence; `idf-slam download --list` shows all")
        sequence = find_sequence(self.name)
        plain_printer(console)(sequence.licence)
        columns = (TextColumn("{task.description}"), BarColumn(), DownloadColumn(), TransferSpeedColumn(), TimeRemainingColumn())
        with Progress(*columns, console=console) as progress:
            task = progress.add_task(sequence.name, total=None)

            def report(done: int, total: int | None) -> None:
                unpacking = done == total
                progress.update(task, completed=done, total=total, description="unpacking" if unpacking else sequence.name)

            folder = download(sequence, self.out, report=report)
        for recording in sequence.run:
            plain_printer(output())(f"idf-slam run {folder / recording}")
