"""YAML that people write: one document of plain values. Whatever is wrong with one is an error of one line."""

from pathlib import Path
from typing import Any

import yaml

from idfslam.errors import IdfSlamError
from idfslam.storage.plain_values import DEEPEST, check_plain, check_size, one_line, shown
from idfslam.storage.text_file import read_text

_LARGEST = 1 << 20  # [bytes] of a file; raised, longer lists can be read, and PyYAML takes minutes for tens of megabytes. Chosen by hand
# What PyYAML raises besides its own errors for a value that does not fit its tag, such as `!!bool maybe`
_MISFITS = (ValueError, KeyError, IndexError, TypeError, AttributeError, OverflowError, RecursionError)


class _Loader(yaml.SafeLoader):
    """Safe values without aliases, which make large values of short texts, and without repeated keys, of which one would be ignored."""

    _depth = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            raise yaml.composer.ComposerError(None, None, "an alias (*name), write the value out", self.peek_event().start_mark)
        self._depth += 1
        if self._depth > DEEPEST:  # PyYAML calls itself for each level
            raise yaml.composer.ComposerError(None, None, f"more than {DEEPEST} levels", self.peek_event().start_mark)
        node = super().compose_node(parent, index)
        self._depth -= 1
        return node

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        names = [key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode)]
        if len(set(names)) < len(names):
            name = next(name for name in names if names.count(name) > 1)
            raise yaml.constructor.ConstructorError(None, None, f"'{name}' stands twice", node.start_mark)
        return super().construct_mapping(node, deep)


def read_yaml(path: Path, *, error: type[IdfSlamError], expected: str) -> Any:
    """The values of a YAML file; None if it is empty. Raises `error` if it cannot be read or is not what this project takes as YAML.

    expected: what the file should be, for the message, such as "the values of a run".
    """
    try:
        check_size(path.stat().st_size, str(path), error, expected, largest=_LARGEST)
        text = read_text(path)
    except OSError as caught:
        raise error(f"{path}: {caught.strerror}, expected {expected}") from caught
    return parse_yaml(text, source=str(path), error=error, expected=expected)


def parse_yaml(text: str, *, source: str, error: type[IdfSlamError], expected: str) -> Any:
    """The values of a YAML text, as `read_yaml` returns them. source: names the text in messages."""
    try:
        values = yaml.load(text, _Loader)
        check_plain(values)
    except (yaml.YAMLError, *_MISFITS) as caught:
        raise error(f"{source}: is not YAML ({_reason(caught)}), expected {expected}") from caught
    return values


def _reason(error: Exception) -> str:
    """PyYAML's message without the text around the place."""
    mark = getattr(error, "problem_mark", None)
    if mark is None:
        return shown(error)
    return f"line {mark.line + 1}, column {mark.column + 1}: {one_line(str(getattr(error, 'problem', '')))}"
