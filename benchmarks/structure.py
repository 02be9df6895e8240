"""The structure of the code in numbers: sizes, imports, and how far one frame travels through it.

    python benchmarks/structure.py [SRC]

SRC: the `src` folder of a checkout; none given: the installed package's. A frame's way is that of the tenth frame of a generated room with
the fast preset, which is no keyframe: the functions of the package that it enters, the files that they lie in, and the calls that go from
one file into another. Compiled kernels count as their callers; the map's own thread does not count.
"""

import ast
import sys
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import Any

FRAMES = 10


def modules(package: Path) -> dict[str, Path]:
    """Every module of the package by its dotted name."""
    names = {".".join(path.relative_to(package.parent).with_suffix("").parts): path for path in sorted(package.rglob("*.py"))}
    return {name.removesuffix(".__init__"): path for name, path in names.items()}


def code_lines(text: str) -> int:
    """Lines that hold code: neither blank nor comment nor docstring."""
    tree = ast.parse(text)
    documented = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    docstrings = {
        line
        for node in ast.walk(tree)
        if isinstance(node, documented)
        and node.body
        and isinstance(node.body[0], ast.Expr)
        and isinstance(node.body[0].value, ast.Constant)
        for line in range(node.body[0].lineno, (node.body[0].end_lineno or 0) + 1)
    }
    lines = enumerate(text.splitlines(), start=1)
    return sum(1 for i, line in lines if line.strip() and not line.strip().startswith("#") and i not in docstrings)


def functions(text: str) -> Iterator[tuple[str, int]]:
    """Each function and its length in lines, docstring and all."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield node.name, (node.end_lineno or 0) - node.lineno + 1


def imports(text: str, names: set[str]) -> set[str]:
    """The package's modules that a file imports, anywhere in it."""
    found = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ImportFrom) and node.module:
            found |= {f"{node.module}.{alias.name}" if f"{node.module}.{alias.name}" in names else node.module for alias in node.names}
    return {name for name in found if name.startswith("idfslam")}


def way_of_a_frame(package: Path) -> tuple[int, int, int]:
    """Functions entered, files, and calls from one file into another, while a frame is processed that becomes no keyframe."""
    from idfslam.datasets import open_recording
    from idfslam.slam import Slam

    slam, recording = Slam(), open_recording("synthetic:0", frames=FRAMES)
    for i in range(FRAMES - 1):
        slam.process(recording[i])
    frame, entered, crossings = recording[FRAMES - 1], set[tuple[str, str, int]](), 0

    def note(called: FrameType, event: str, _: Any) -> None:
        nonlocal crossings
        file = called.f_code.co_filename
        if event == "call" and file.startswith(str(package)) and not called.f_code.co_name.startswith("<"):
            entered.add((file, called.f_code.co_name, called.f_code.co_firstlineno))
            caller = called.f_back
            crossings += caller is not None and caller.f_code.co_filename != file and caller.f_code.co_filename.startswith(str(package))

    sys.setprofile(note)
    result = slam.process(frame)
    sys.setprofile(None)
    assert not result.keyframe
    return len(entered), len({file for file, *_ in entered}), crossings


def main() -> None:
    if len(sys.argv) > 1:
        sys.path.insert(0, sys.argv[1])
    import idfslam

    package = Path(str(idfslam.__file__)).parent
    texts = {name: path.read_text(encoding="utf-8") for name, path in modules(package).items()}
    lengths = sorted(((lines, f"{name}.{function}") for name, text in texts.items() for function, lines in functions(text)), reverse=True)
    longest = max(texts, key=lambda name: len(texts[name].splitlines()))
    system = next(name for name in ("idfslam.slam.slam", "idfslam.slam") if name in texts)
    root = [path for path in package.glob("*.py") if path.name != "__init__.py"]
    print(f"files {len(texts)}, packages {sum(path.name == '__init__.py' for path in package.rglob('*.py'))}, in the root {len(root)}")
    print(f"lines {sum(len(t.splitlines()) for t in texts.values())}, of code {sum(code_lines(t) for t in texts.values())}")
    print(f"longest file {longest} {len(texts[longest].splitlines())}")
    print(f"functions {len(lengths)}, longest {lengths[0][1]} {lengths[0][0]}, longer than 50 lines {sum(n > 50 for n, _ in lengths)}")
    print(f"{system}: {len(texts[system].splitlines())} lines, {len(imports(texts[system], set(texts)))} imports of the package")
    print("a frame's way: {} functions in {} files, {} calls from file to file".format(*way_of_a_frame(package)))


if __name__ == "__main__":
    main()
