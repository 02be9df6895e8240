"""The constants of the algorithms, read from the code: what stands at the head of each file, with the comment that explains it."""

import ast
import itertools
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

PACKAGES = (
    *("sensing", "alignment", "tracking", "graph", "mapping", "slam"),
    *("datasets", "runs", "storage", "export", "batch", "viewer", "evaluation"),
)
"""Those whose constants decide what is read, what a run gives, and what is made of it."""


@dataclass(frozen=True)
class Constant:
    """A module's constant."""

    module: str  # within the package, such as slam/place_recognition/recovery.py
    name: str
    value: str  # as it is written
    comment: str  # at its line and the lines below that go on with it, or in the block above; empty: there is none


def constants(package: Path) -> Iterator[Constant]:
    """All constants of PACKAGES that are numbers or made of numbers; kernels' own block sizes are not among them."""
    for part in PACKAGES:
        for path in sorted(path for path in (package / part).rglob("*.py") if "kernels" not in path.parts):
            text, module = path.read_text(encoding="utf-8"), path.relative_to(package).as_posix()
            for node in ast.parse(text).body:
                if isinstance(node, ast.Assign) and _is_numeric(node.value):
                    for name in _names(node.targets[0]):
                        yield Constant(module, name, ast.unparse(node.value), _comment(text.splitlines(), node))


def _names(target: ast.expr) -> list[str]:
    """The names that are assigned, if they are written in capitals."""
    targets = target.elts if isinstance(target, ast.Tuple) else [target]
    names = [node.id for node in targets if isinstance(node, ast.Name) and node.id.isupper()]
    return [", ".join(names)] if names else []


def _is_numeric(value: ast.expr) -> bool:
    allowed = (ast.Constant, ast.Tuple, ast.UnaryOp, ast.USub, ast.BinOp, ast.operator, ast.Call, ast.Attribute, ast.Name, ast.Load)
    nodes = list(ast.walk(value))
    numbers = [node for node in nodes if isinstance(node, ast.Constant)]
    texts = any(not isinstance(node.value, int | float) or isinstance(node.value, bool) for node in numbers)
    calls = {ast.unparse(node.func) for node in nodes if isinstance(node, ast.Call)}
    return bool(numbers) and not texts and all(isinstance(node, allowed) for node in nodes) and calls <= {"math.radians"}


def _comment(lines: list[str], node: ast.Assign) -> str:
    """The comment behind a constant and its continuation below; else the block of comment lines directly above."""
    last = (node.end_lineno or node.lineno) - 1
    behind = re.search(r"  # (.*)$", lines[last])
    if behind is None:
        above = list(itertools.takewhile(lambda line: line.startswith("# "), reversed(lines[: node.lineno - 1])))
        return " ".join(line[2:] for line in reversed(above))
    parts = [behind[1]]
    for line in lines[last + 1 :]:
        more = re.match(r"#\s{2,}(.*)$", line)
        if more is None:
            break
        parts.append(more[1])
    return " ".join(parts)


def page(package: Path) -> str:
    """The page of the documentation."""
    parts = [
        "# Constants",
        "Values that are no flags, each where it stands in the code, with its unit and what raising it does. Values that users or "
        "experiments change are flags ([configuration](configuration.md)).",
    ]
    module = ""
    for constant in constants(package):
        if constant.module != module:
            module = constant.module
            parts.append(f"## {module}\n\n| constant | value | meaning |\n|---|---|---|")
        parts[-1] += f"\n| `{constant.name}` | `{constant.value}` | {constant.comment.replace('|', chr(92) + '|')} |"
    return "\n\n".join(parts) + "\n"


if __name__ == "__main__":
    print(page(Path(__file__).parent.parent / "src" / "idfslam"))
