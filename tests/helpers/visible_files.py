"""What a user sees in a folder that the program wrote to."""

from pathlib import Path

from idfslam.storage.output_folder import HIDDEN


def visible_files(folder: Path) -> list[str]:
    """The sorted names of what is in a folder, without the ledger and the lock."""
    return sorted(path.name for path in folder.iterdir() if path.name not in HIDDEN)
