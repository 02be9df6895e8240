"""What the type of a configuration field says beyond its plain type: which numbers are allowed, and whether users set it.

`pixels: Count = 512` must be at least 1. `resolution: UserOption[Positive] = 0.02` must be more than 0 and is shown by `--help`; a field
without `UserOption` is shown by `--help-all` alone. Every number must be finite and at least 0. The docstring below a field is its help.
"""

import ast
import inspect
import sys
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any, TypeVar, get_type_hints

T = TypeVar("T")


@dataclass(frozen=True)
class AtLeast:
    """A lower bound that is allowed itself."""

    least: float

    def allows(self, value: float) -> bool:
        """Whether a number is within the bound."""
        return value >= self.least

    def __str__(self) -> str:
        return f"at least {self.least:g}"


@dataclass(frozen=True)
class MoreThan:
    """A lower bound that is not allowed itself."""

    limit: float

    def allows(self, value: float) -> bool:
        """Whether a number is within the bound."""
        return value > self.limit

    def __str__(self) -> str:
        return f"more than {self.limit:g}"


@dataclass(frozen=True)
class ZeroOrAtLeast:
    """A lower bound; 0 switches the thing off."""

    least: float

    def allows(self, value: float) -> bool:
        """Whether a number is within the bound."""
        return value == 0 or value >= self.least

    def __str__(self) -> str:
        return f"0 or at least {self.least:g}"


Bound = AtLeast | MoreThan | ZeroOrAtLeast


class _ForUsers:
    """Marks a field that `--help` shows."""


Count = Annotated[int, AtLeast(1)]
Positive = Annotated[float, MoreThan(0)]
EveryNth = Annotated[int, ZeroOrAtLeast(2)]
UserOption = Annotated[T, _ForUsers()]


def field_types(section: type) -> dict[str, Any]:
    """The type of each field of a section, with what it says beyond the plain type."""
    return get_type_hints(section, include_extras=True)


def bounds(field_type: Any) -> list[Bound]:
    """The bounds that a field's type states."""
    return [extra for extra in getattr(field_type, "__metadata__", ()) if isinstance(extra, Bound)]


def is_user_option(field_type: Any) -> bool:
    """Whether `--help` shows the field."""
    return any(isinstance(extra, _ForUsers) for extra in getattr(field_type, "__metadata__", ()))


def meanings(section: type) -> dict[str, str]:
    """The docstring below each field of a section, in one line; fields without one, such as nested sections, are left out."""
    return _docstrings(section.__module__)[section.__name__]


@cache
def _docstrings(module: str) -> dict[str, dict[str, str]]:
    """The docstrings below the fields of each class of a module, by the names of class and field."""
    tree = ast.parse(inspect.getsource(sys.modules[module]))
    texts: dict[str, dict[str, str]] = {}
    for definition in (node for node in tree.body if isinstance(node, ast.ClassDef)):
        texts[definition.name] = {}
        for field, text in zip(definition.body, definition.body[1:]):
            if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name) and isinstance(text, ast.Expr):
                assert isinstance(text.value, ast.Constant)
                texts[definition.name][field.target.id] = " ".join(str(text.value.value).split())
    return texts
