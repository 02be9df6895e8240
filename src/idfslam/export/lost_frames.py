"""Tells apart frames whose pose was not measured or is in doubt: in remarks, and in lost.txt beside files without room for remarks."""

from collections.abc import Iterable, Sequence
from pathlib import Path

from idfslam.frame import Status
from idfslam.storage import atomic_files

LOST = "lost.txt"


def write_lost(folder: Path, header: str, frames: Iterable[tuple[str, Status]]) -> list[Path]:
    """Writes a line `NAME STATUS` for each of the frames. Without frames an earlier lost.txt is removed. Returns the paths written."""
    path, lines = folder / LOST, [f"{name} {status.value}\n" for name, status in frames]
    if not lines:
        path.unlink(missing_ok=True)
        return []
    with atomic_files.replacing(path) as part:
        part.write_text(f"# {header} status\n{''.join(lines)}", encoding="utf-8")
    return [path]


def remarked(tum: str, statuses: Sequence[Status]) -> str:
    """A trajectory in TUM format with a remark before each pose (N,) that is not trusted; readers pass over lines that begin with #."""
    header, *poses = tum.splitlines(keepends=True)
    return header + "".join(_remark(status) + pose for status, pose in zip(statuses, poses, strict=True))


def _remark(status: Status) -> str:
    if status.trusted:
        return ""
    return f"# {status.value}: the next pose {'may be wrong' if status.measured else 'was not measured'}\n"
