"""Text files that list images: words in lines, with the separators, line ends and headers that people's programs write."""

import os
import re
from pathlib import Path

from idfslam.datasets.images.decoding import DEPTH_SUFFIXES, SUFFIXES
from idfslam.storage.text_file import read_text

_COMMAS = re.compile(r"[^\s,;]+\s*[,;]")  # a first word with a comma behind it: the file's separator


def listed_lines(path: Path) -> list[tuple[int, list[str]]]:
    """Number and words of each line; `#` starts a comment. A first line without any digit is a header and left out.

    Words are separated by white space or, where one follows the first word, by commas or semicolons. Raises OSError.
    """
    lines: list[tuple[int, list[str]]] = []
    header = True
    for place, text in enumerate(read_text(path).split("\n"), 1):
        line = text.split("#")[0].strip()
        words = [word for word in (re.split(r"\s*[,;]\s*|\s+", line) if _COMMAS.match(line) else line.split()) if word]
        if words and not (header and not any(c.isdigit() for c in line)):
            lines.append((place, words))
        header = header and not words
    return lines


def number(word: str) -> float:
    """The number that a word states; NaN if it states none."""
    try:
        return float(word)
    except ValueError:
        return float("nan")


def listed_image(folder: Path, word: str) -> tuple[Path, str]:
    """The image that a list in `folder` names by `word`, and what is wrong with it; empty: nothing.

    Backslashes separate folders too. An absolute path from another machine is looked for by its last two parts in `folder`.
    """
    name = word.strip("\"'").replace("\\", "/")
    path = folder / name
    if path.suffix.lower() not in SUFFIXES | DEPTH_SUFFIXES:
        return path, "is not the name of an image"
    if not os.path.isfile(path):  # unlike Path.is_file, it takes names that are too long or hold NUL
        path = Path(folder, *Path(name).parts[-2:])
    return path, "" if os.path.isfile(path) else "does not exist"
