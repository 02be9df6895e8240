"""The path of a recording, and the names it goes by. A symbolic link is a name that the user gave: it is kept, in every command."""

from pathlib import Path


def absolute(path: Path | str) -> Path:
    """The path made valid in any folder. Links in it stay, unless it has `..`, which means the parent of what a link leads to."""
    place = Path(path).expanduser().absolute()  # absolute, so that even "." has a name
    return place.resolve() if ".." in place.parts else place


def names(path: Path) -> tuple[str, ...]:
    """The names of a recording that can tell which data set it is of: the one given first, then that of what a link leads to."""
    return tuple(dict.fromkeys((path.name, path.resolve().name)))
