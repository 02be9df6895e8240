"""Finds the colour and depth images of a plain folder: two folders with names in use, or one folder with both kinds of file."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from idfslam.datasets.images import video
from idfslam.datasets.images.decoding import DEPTH_SUFFIXES, SUFFIXES, hidden

# Names without case, digits and separators; of several folders the first name counts
COLOUR_NAMES = ("rgb", "color", "colour", "rgbimages", "colorimages", "colourimages", "rgbimage", "colorimage", "images", "image", "img")
DEPTH_NAMES = ("depth", "depths", "depthimages", "depthimage", "depthmaps", "depthmap", "aligneddepth", "depthaligned", "registereddepth")
_COLOUR_WORD = re.compile(r"rgb|colou?r", re.IGNORECASE)
_DEPTH_WORD = re.compile(r"depth|(^|[_\-. ])d([_\-. \d]|$)", re.IGNORECASE)
_PHOTOGRAPHS = frozenset({".jpg", ".jpeg"})  # forms of files that hold no depth
_OTHER_WORD = re.compile(r"infra|(^|[^a-z])ir([^a-z]|$)|conf|mask|label|semantic|segment|normal|preview|thumb", re.IGNORECASE)


@dataclass(frozen=True)
class ImageFolders:
    """The colour and depth images of a folder, in no order."""

    colour: list[Path]
    depth: list[Path]


def find_images(path: Path) -> ImageFolders | None:
    """The images of the folder; None if it has not both kinds. The files in a named folder all count, whatever they are called."""
    colour, depth = colour_folder(path), depth_folder(path)
    if colour is not None and depth is not None:
        return ImageFolders(_files(colour, SUFFIXES), _files(depth, DEPTH_SUFFIXES) or _files(depth, SUFFIXES))
    for folder in (path, *([colour] if colour else [])):
        images = _both_kinds(folder)
        if images is not None:
            return images
    return None


def colour_folder(path: Path) -> Path | None:
    """The folder of colour images, if there is one."""
    return _named(path, COLOUR_NAMES, _COLOUR_WORD, without=_DEPTH_WORD)


def depth_folder(path: Path) -> Path | None:
    """The folder of depth images, if there is one."""
    return _named(path, DEPTH_NAMES, _DEPTH_WORD, without=None)


def has_colour(path: Path) -> bool:
    """Whether a folder has colour images, or a video, whatever else it lacks."""
    return colour_folder(path) is not None or bool(_files(path, SUFFIXES - {".png"} | video.SUFFIXES)) or _has(path, _COLOUR_WORD)


def has_depth(path: Path) -> bool:
    """Whether a folder has depth images, whatever else it lacks."""
    return depth_folder(path) is not None or _has(path, _DEPTH_WORD)


def _has(path: Path, word: re.Pattern[str]) -> bool:
    return any(word.search(file.stem) for file in _files(path, SUFFIXES | DEPTH_SUFFIXES))


def _named(path: Path, names: Sequence[str], word: re.Pattern[str], without: re.Pattern[str] | None) -> Path | None:
    """The folder with the first of the names, else the only one whose name holds the word."""
    folders = sorted((entry for entry in path.iterdir() if entry.is_dir() and not hidden(entry)), reverse=True) if path.is_dir() else []
    plain = {re.sub(r"[^a-z]", "", folder.name.lower()): folder for folder in reversed(folders)}
    plain |= {folder.name: folder for folder in folders}
    if found := [plain[name] for name in names if name in plain]:
        return found[0]
    similar = [entry for entry in folders if word.search(entry.name) and not (without and without.search(entry.name))]
    similar = [entry for entry in similar if not _OTHER_WORD.search(entry.name)]
    return similar[0] if len(similar) == 1 else None


def _files(folder: Path, suffixes: frozenset[str]) -> list[Path]:
    return [file for file in (folder.iterdir() if folder.is_dir() else ()) if file.suffix.lower() in suffixes and not hidden(file)]


def _both_kinds(folder: Path) -> ImageFolders | None:
    """0001_color.png and 0001_depth.png; 0001.jpg and 0001_depth.png; 0001.jpg and 0001.png. None if the folder has not both."""
    files = [file for file in _files(folder, SUFFIXES | DEPTH_SUFFIXES) if not _OTHER_WORD.search(file.stem)]
    depth = [file for file in files if _DEPTH_WORD.search(file.stem) and file.suffix.lower() in DEPTH_SUFFIXES]
    rest = [file for file in files if not _DEPTH_WORD.search(file.stem) and file.suffix.lower() in SUFFIXES]
    colour = [file for file in rest if _COLOUR_WORD.search(file.stem)] or rest
    if not depth:  # 0001.jpg and 0001.png
        names = {file.stem for file in rest if file.suffix.lower() in _PHOTOGRAPHS}
        depth = [file for file in files if file.stem in names and file.suffix.lower() in DEPTH_SUFFIXES - _PHOTOGRAPHS]
        colour = [file for file in rest if file.suffix.lower() in _PHOTOGRAPHS]
    return ImageFolders(colour, depth) if colour and depth and any(re.search(r"\d", file.stem) for file in depth) else None
