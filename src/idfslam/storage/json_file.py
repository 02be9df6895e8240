"""JSON from files that people and other programs write. Whatever is wrong with one is an error of one line."""

import json
from pathlib import Path
from typing import Any

from idfslam.errors import IdfSlamError
from idfslam.storage.plain_values import check_plain, check_size, shown
from idfslam.storage.text_file import read_text


def read_json(path: Path, *, error: type[IdfSlamError], expected: str) -> Any:
    """The values of a JSON file, with `NaN` and `Infinity` as floats. Raises `error` if it cannot be read or is no JSON.

    expected: what the file should be, for the message, such as "the camera of a recording". A byte order mark is allowed, and a key that
    stands twice in one object is not: one of the two would be ignored.
    """
    try:
        check_size(path.stat().st_size, str(path), error, expected)
        text = read_text(path)
    except OSError as caught:
        raise error(f"{path}: {caught.strerror}, expected {expected}") from caught
    return parse_json(text, source=str(path), error=error, expected=expected)


def parse_json(text: str | bytes, *, source: str, error: type[IdfSlamError], expected: str) -> Any:
    """The values of a JSON text, as `read_json` returns them. source: names the text in messages."""
    try:
        check_size(len(text), source, error, expected)
        values = json.loads(text, object_pairs_hook=_object)
        check_plain(values)
    except (ValueError, RecursionError) as caught:
        raise error(f"{source}: is not JSON ({shown(caught)}), expected {expected}") from caught
    return values


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    values = dict(pairs)
    if len(values) < len(pairs):
        names = [name for name, _ in pairs]
        raise ValueError(f"{next(name for name in names if names.count(name) > 1)!r} stands twice in one object")
    return values
