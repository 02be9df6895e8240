"""Which layout a folder resembles that is not a recording, and what it lacks of it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Part:
    """A file or folder that a layout needs: its name in words, and whether a folder has it."""

    name: str
    present: Callable[[Path], bool]


@dataclass(frozen=True)
class Likeness:
    """A layout in words ("a Stray Scanner folder") and the parts that it needs. A layout that consists of one file has none."""

    kind: str
    parts: tuple[Part, ...]


def part(pattern: str, name: str = "") -> Part:
    """A file or folder of this name or pattern."""
    return Part(name or pattern, lambda path: any(path.glob(pattern)))


def near_miss(path: Path, layouts: Sequence[Likeness]) -> str | None:
    """What a folder resembles and lacks, in words; None if it has no part of any layout.

    It is the layout of which the folder has the largest share; of equal ones that with more parts found, then the first.
    """
    best: tuple[tuple[float, int], str] | None = None
    for layout in layouts:
        missing = [part.name for part in layout.parts if not part.present(path)]
        found = len(layout.parts) - len(missing)
        share = (found / max(len(layout.parts), 1), found)
        if found and missing and (best is None or share > best[0]):
            needed = " and ".join(part.name for part in layout.parts)
            best = share, f"looks like {layout.kind} without {' and '.join(missing)}, expected {needed}"
    return best[1] if best else None
