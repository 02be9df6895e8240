"""Limits on what files of people and other programs may hold, whatever their format."""

from types import UnionType
from typing import Any, get_args, get_origin

from idfslam.errors import IdfSlamError

LARGEST = 1 << 28  # [bytes] of a file that is read as a whole; raised, more memory is needed. 500 000 keyframes fit. Chosen by hand
DEEPEST = 32  # lists and mappings inside each other; raised, deeper files pass. Our own have 5. Chosen by hand
_INTEGERS = 1 << 63  # integers beyond this are refused; raised, float() and numpy refuse the longest ones. Nothing that is read counts so
#    far
_LONGEST = 200  # characters of a value or a reason that a message shows; raised, messages are longer. Chosen by hand


def check_plain(values: Any) -> None:
    """Raises ValueError for nesting that is too deep, integers beyond 64 bits, and text with NUL or half a character."""
    level = [values]
    for _ in range(DEEPEST):
        inner: list[Any] = []
        for value in level:
            if isinstance(value, dict):
                inner += [*value.keys(), *value.values()]
            elif isinstance(value, list | tuple | set):
                inner += value
            elif isinstance(value, int):
                if abs(value) >= _INTEGERS:
                    raise ValueError(f"a number of {value.bit_length() // 3.32:.0f} digits")
            elif isinstance(value, str):
                if "\0" in value:
                    raise ValueError("text with a NUL")
                value.encode()  # raises UnicodeEncodeError, a ValueError
        if not inner:
            return
        level = inner
    raise ValueError(f"more than {DEEPEST} lists and mappings inside each other")


def fits(value: Any, expected: Any) -> bool:
    """Whether a value is of a type, of one of several, or a mapping of such."""
    if isinstance(expected, UnionType):
        return any(fits(value, one) for one in get_args(expected))
    if get_origin(expected) is dict:
        of_names, of_values = get_args(expected)
        return isinstance(value, dict) and all(fits(name, of_names) and fits(inner, of_values) for name, inner in value.items())
    if expected in (int, float):
        return isinstance(value, int | expected) and not isinstance(value, bool)
    return isinstance(value, expected)


def shown(value: Any) -> str:
    """A value as Python writes it, or the text of an error, in one line and cut to 200 characters."""
    try:
        return one_line(str(value) if isinstance(value, Exception) else repr(value))
    except (ValueError, RecursionError):  # an integer with more digits than Python shows, a list in itself
        return f"a {type(value).__name__} that is too long to show"


def fault(error: Exception) -> str:
    """What is wrong with values, by the error that reading them raised, in words of people who do not know Python's."""
    if isinstance(error, KeyError):
        return f"no {shown(error)}"
    if isinstance(error, TypeError | AttributeError):
        return "values of other kinds"
    return "too few values" if isinstance(error, IndexError) else shown(error)


def one_line(text: str) -> str:
    """A text for a message, in one line and cut to 200 characters."""
    text = " ".join(text.split())
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}..."


def check_size(size: int, source: str, error: type[IdfSlamError], expected: str, *, largest: int = LARGEST) -> None:
    """Raises `error` if a file has more bytes than the `largest` that is read as a whole."""
    if size > largest:
        raise error(f"{source}: {size >> 20} MB, expected {expected} of at most {largest >> 20} MB: is it another file?")
