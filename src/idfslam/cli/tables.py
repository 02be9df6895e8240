"""The output of the commands: tables of results, and the paths of the files written."""

from collections.abc import Iterable, Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table
from rich.text import Text

from idfslam.adjustment.camera_findings import Finding
from idfslam.batch.batch import REPORT, Row
from idfslam.cli.doctor import GIB, Examination
from idfslam.cli.plain_text import plain_printer
from idfslam.downloads import catalogue
from idfslam.errors import pip_install
from idfslam.evaluation.evaluation import Evaluation
from idfslam.evaluation.table import table
from idfslam.evaluation.view_error import ViewError, summary
from idfslam.pictures.view_comparison import PICTURE, VIEWS
from idfslam.runs import result_folder
from idfslam.runs.metrics import ate_rmse, measured_ate_rmse
from idfslam.runs.runner import RunResult


def print_run(run: RunResult, console: Console) -> None:
    """Prints speed, keyframes, lost frames, the ATE if ground truth is known, and the result files."""
    m = run.metrics
    lines = [
        f"{m['frames']} frames in {m['seconds']:.0f} s: {m['frames_per_second']:.2f} frames/s",
        f"keyframes {m['keyframes']}, lost frames {m['lost_frames']}, doubtful frames {m['doubtful_frames']}, "
        f"peak memory {m['peak_memory_mb']:.0f} MiB",
    ]
    if (ate := ate_rmse(m)) is not None:
        measured = measured_ate_rmse(m)
        rest = f"; {measured[0] * 100:.2f} cm over the {measured[1]} frames with a measured pose" if measured else ""
        lines.append(f"ATE RMSE {ate * 100:.2f} cm{rest}")
    console.print("\n".join(lines), highlight=False)
    also = (result_folder.REPORT, result_folder.SCENE, result_folder.RECORDING)
    print_files(
        run.folder,
        sorted(name for name in (*result_folder.FILES, *also) if (run.folder / name).is_file()),
        console,
    )


def print_calibration(found: Sequence[Finding], landmarks: int, sightings: int, noise: float, console: Console) -> None:
    """Prints each property of a camera with its standard deviation, and what it changes."""
    tell = plain_printer(console)
    for finding in found:
        tell(f"{finding.name}: {finding.found}\n  {finding.meaning}")
    counts = f"{landmarks} landmarks, seen {sightings} times, to {noise:.2f} px at a width of 640"
    doubts = "; ".join(finding.doubt for finding in found if finding.doubt)
    verdict = f"the stated camera does not fit: {doubts}" if doubts else "the stated camera fits"
    tell(f"{counts}\n{verdict}")


def print_evaluation(evaluation: Evaluation, folder: Path, console: Console) -> None:
    """Prints the errors, and the paths of JSON and pictures."""
    console.print(table(evaluation))
    print_files(folder, result_folder.EVALUATION_FILES, console)


def print_views(errors: Sequence[ViewError], folder: Path, console: Console) -> None:
    """Prints the means over held-out views, and the paths of JSON and picture."""
    mean = summary(errors)
    text = f"{mean['count']} held-out views: PSNR {mean['psnr']:.2f} dB ({mean['psnr_matched']:.2f} at the exposure of each image)"
    rest = f"SSIM {mean['ssim']:.3f}, holes {mean['holes'] * 100:.2f} %, {mean['seconds']:.2f} s a view"
    plain_printer(console)(f"{text}, {rest}")
    print_files(folder, (VIEWS, PICTURE), console)


def print_batch(rows: list[Row], folder: Path, console: Console) -> None:
    """Prints a row for each recording, the reasons of failures, and the path of batch.json."""
    table = Table()
    for title in ("recording", "status"):
        table.add_column(title, overflow="fold")
    for title in ("ATE [cm]", "frames/s", "seconds"):
        table.add_column(title, justify="right")
    table.add_column("where", overflow="fold")
    for row in rows:
        ate = "-" if row.ate_m is None else f"{row.ate_m * 100:.2f}"
        speed = "-" if row.frames_per_second is None else f"{row.frames_per_second:.2f}"
        again = "" if row.attempts < 2 else f", attempt {row.attempts}"
        table.add_row(row.name, row.status + again, ate, speed, f"{row.seconds:.0f}", row.where)
    console.print(table)
    for row in rows:
        if row.error is not None and row.attempts:
            plain_printer(console)(f"{row.name}: {row.error}")
    print_files(folder, [REPORT], console)


def print_examination(examination: Examination, console: Console) -> None:
    """Prints the properties of the machine, the extras, and what should be fixed."""
    e = examination.found
    processor, torch, memory, cache = e["processor"], e["torch"], e["memory_bytes"], e["numba_cache"]
    unknown = "unknown"
    free = unknown if memory is None else f"{memory['available'] / GIB:.1f} of {memory['total'] / GIB:.1f} GiB available"
    kernels = f"{cache['kernels']} kernels in {cache['folder']}" if cache["kernels"] else "nothing yet: the first run takes a minute more"
    rows = [
        ("idf-slam", f"{e['idf-slam']}, Python {e['python']}, {e['system']}"),
        ("torch", f"{torch['version']}, " + (f"CUDA {torch['cuda']}" if torch["cuda"] else "no CUDA in this build")),
        ("packages", ", ".join(f"{name} {found}" for name, found in e["packages"].items())),
        ("processor", f"{processor['name']}, {processor['cores']} cores"),
        ("instructions", ", ".join(processor["instruction_sets"]) or unknown),
        ("GPUs", ", ".join(torch["gpus"]) or "none"),
        ("threads", ", ".join(f"{name}={value}" for name, value in e["threads"].items() if value)),
        ("memory", free),
        ("disk", f"{e['free_disk_bytes'] / GIB:.1f} GiB free"),
        ("compiled", kernels),
        ("weights", f"{e['weights']['path']}, {'found' if e['weights']['loaded'] else 'not usable'}"),
    ]
    if e["used"] is not None:
        used = e["used"]
        precision = f"tracker {used['tracker_precision']}, map {used['map_precision']}"
        rows.append(("a run uses", f"{used['device']}, {precision}, kernels: {used['kernels']} (preset {used['preset']})"))
    rows += [(name, where) for name, where in e["devices"].items()]
    for name, extra in sorted(e["extras"].items()):
        installed = ", ".join(f"{package} {found}" for package, found in extra["installed"].items())
        missing = f"{', '.join(extra['missing'])} missing: {pip_install(*extra['missing'])}" if extra["missing"] else ""
        rows.append((f"[{name}]", "; ".join(filter(None, (installed, missing)))))
    grid = Table.grid(padding=(0, 2))
    for title, text in rows:
        grid.add_row(Text(title, "bold"), Text(text))
    console.print(grid)
    for line in examination.advice:
        plain_printer(console)(f"to do: {line}")
    console.print("ready" if examination.ready else "not ready", style="green" if examination.ready else "red")


def print_files(folder: Path, names: Iterable[str], console: Console) -> None:
    """Prints one path per line, unwrapped, so that it can be copied."""
    for name in names:
        plain_printer(console)(str(folder / name))


def print_catalogue(sequences: Iterable[catalogue.Sequence], console: Console) -> None:
    """Prints names, sizes and folders of the sequences that can be downloaded, grouped by licence."""
    by_licence: dict[str, Table] = {}
    for sequence in sequences:
        table = by_licence.setdefault(sequence.licence, Table(box=None, show_header=False, pad_edge=True))
        size = "" if sequence.size_mb is None else f"{sequence.size_mb / 1000:.1f} GB"
        table.add_row(sequence.name, size, sequence.folder)
    for licence, table in by_licence.items():
        plain_printer(console)(licence)
        console.print(table, highlight=False)
