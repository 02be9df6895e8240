"""Reads timestamps.txt of a plain folder: lines `number stamp` [s] with the images' numbers, or one stamp a line in the images' order."""

from datetime import datetime, timezone
from pathlib import Path, PurePath

from idfslam.datasets.images.file_list import listed_lines, number
from idfslam.errors import RecordingError
from idfslam.storage.text_file import read_text

STAMPS = "timestamps.txt"
HEADER = "# number timestamp depth_timestamp"
"""A first line by which a third column holds the stamps of depth [s]; without it, what follows in a line may be anything."""


def read_stamps(path: Path, *series: list[float]) -> dict[float, float] | None:
    """The stamps by frame number, sorted by number, NaN where one is neither a number nor a date; None without the file.

    A frame is named by its number, or by its image.

    series: the numbers of all frames, and of those images that one stamp a line may belong to instead. What follows in a line is ignored.
    A last line `number stamp` without a line break was cut off while it was written: it is left out.
    Raises RecordingError if a line has no number, or if there is one stamp a line and no series has as many images.
    """
    if not path.is_file():
        return None
    lines = [(line, words[:2]) for line, words in listed_lines(path)]
    rows = [(line, [*map(_counted, words[:-1]), _seconds(words[-1])]) for line, words in lines]
    if rows and all(len(row) == 1 for _, row in rows):
        numbers = next((numbers for numbers in series if len(numbers) == len(rows)), None)
        if numbers is None:
            found = f"{len(rows)} stamps for {len(series[0])} images"
            raise RecordingError(f"{path}: {found}, expected one for each: complete or remove the file")
        return {counted: row[0] for counted, (_, row) in zip(numbers, rows)}
    if rows and not read_text(path).endswith("\n"):
        rows.pop()
    if without := [line for line, row in rows if row[0] != row[0]]:
        raise RecordingError(f"{path}: line {without[0]} begins with no number, expected the number of a frame and its stamp in seconds")
    return dict(sorted((row[0], row[1] if len(row) > 1 else float("nan")) for _, row in rows))


def read_depth_stamps(path: Path) -> dict[float, float]:
    """The stamps of the depth images by frame number, if the file's first line is HEADER; else, and without the file, none."""
    if not path.is_file() or read_text(path).split("\n", 1)[0].split() != HEADER.split():
        return {}
    return {_counted(words[0]): number(words[2]) for _, words in listed_lines(path) if len(words) > 2}


def _counted(word: str) -> float:
    """The number of a frame that is named by it, or by its image (rgb/000012.png); NaN if there is none."""
    value = number(word)
    return value if value == value else number(PurePath(word).stem)


def _seconds(word: str) -> float:
    """A stamp in any unit, or a date with a time in seconds since 1970; NaN if it is neither."""
    value = number(word)
    if value == value:
        return value
    try:
        moment = datetime.fromisoformat(word.replace("Z", "+00:00"))
    except ValueError:
        return float("nan")
    return moment.timestamp() if moment.tzinfo else moment.replace(tzinfo=timezone.utc).timestamp()
