"""What the commands print when they are done: figures as tables, and where the files are."""

from collections.abc import Iterable
from pathlib import Path

from rich.console import Console
from rich.table import Table

from idfslam import results
from idfslam.downloads.catalogue import Sequence
from idfslam.evaluation.report import Evaluation, table
from idfslam.run import Run


def print_run(run: Run, console: Console) -> None:
    """Speed, keyframes, lost frames, ATE where it is known, and the result folder."""
    m = run.metrics
    lines = [
        f"{m['frames']} frames in {m['seconds']:.0f} s: {m['frames_per_second']:.2f} frames/s",
        f"keyframes {m['keyframes']}, lost frames {m['lost_frames']}, peak memory {m['peak_memory_mb']:.0f} MiB",
    ]
    if "ate_m" in m:
        lines.append(f"ATE RMSE {m['ate_m']['rmse'] * 100:.2f} cm")
    console.print("\n".join(lines), highlight=False)
    print_files(
        run.folder, sorted(name for name in (*results.FILES, results.REPORT, results.RECORDING) if (run.folder / name).is_file()), console
    )


def print_evaluation(evaluation: Evaluation, folder: Path, console: Console) -> None:
    """The errors, and where JSON and pictures are."""
    console.print(table(evaluation))
    print_files(folder, results.EVALUATION_FILES, console)


def print_files(folder: Path, names: Iterable[str], console: Console) -> None:
    """A path a line, whole, so that it can be copied."""
    for name in names:
        console.print(str(folder / name), highlight=False, soft_wrap=True, markup=False)


def print_catalogue(sequences: Iterable[Sequence], console: Console) -> None:
    """Names, sizes and folders of what can be downloaded, under the terms it is published on."""
    by_licence: dict[str, Table] = {}
    for sequence in sequences:
        table = by_licence.setdefault(sequence.licence, Table(box=None, show_header=False, pad_edge=True))
        size = "" if sequence.size_mb is None else f"{sequence.size_mb / 1000:.1f} GB"
        table.add_row(sequence.name, size, sequence.folder)
    for licence, table in by_licence.items():
        console.print(licence, highlight=False, soft_wrap=True, markup=False)
        console.print(table, highlight=False)
