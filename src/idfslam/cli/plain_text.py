"""Text on a console as it is: without markup, colours and line breaks, so that paths and numbers can be copied."""

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console


def plain_printer(console: "Console") -> Callable[[str], None]:
    """A function that prints text, which may have several lines."""
    return partial(console.print, highlight=False, markup=False, soft_wrap=True)
