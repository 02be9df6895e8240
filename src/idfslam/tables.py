"""What the commands print when they are done: figures as tables, and where the files are."""

from collections.abc import Iterable
from pathlib import Path

from rich.console import Console
from rich.table import Table

from idfslam import results
from idfslam.evaluate import EVALUATION, PICTURE, Evaluation
from idfslam.evaluation.trajectory_error import Statistics
from idfslam.run import Run


def print_run(run: Run, console: Console) -> None:
    """Speed, keyframes, lost frames, ATE where it is known, and the result folder."""
    m = run.metrics
    lines = [
        f"{m['frames']} frames in {m['seconds']:.0f} s: {m['frames_per_second']:.2f} frames/s",
        f"{m['keyframes']} keyframes, {m['lost_frames']} frames lost, {m['peak_memory_mb']:.0f} MiB of memory at most",
    ]
    if "ate_m" in m:
        lines.append(f"ATE RMSE {m['ate_m']['rmse'] * 100:.2f} cm")
    console.print("\n".join(lines), highlight=False)
    print_files(run.folder, sorted(name for name in results.FILES if (run.folder / name).is_file()), console)


def print_evaluation(evaluation: Evaluation, folder: Path, console: Console) -> None:
    """The errors, and where JSON and picture are."""
    console.print(_trajectory_table(evaluation))
    if evaluation.mesh is not None:
        console.print(_mesh_table(evaluation))
    print_files(folder, (EVALUATION, PICTURE), console)


def print_files(folder: Path, names: Iterable[str], console: Console) -> None:
    """A path a line, whole, so that it can be copied."""
    for name in names:
        console.print(str(folder / name), highlight=False, soft_wrap=True, markup=False)


def _trajectory_table(evaluation: Evaluation) -> Table:
    table = Table(
        "", "RMSE", "mean", "median", "max", title=f"trajectory, {len(evaluation.ate.frames)} of {evaluation.frames} frames with truth"
    )
    table.add_row("ATE [cm]", *_numbers(evaluation.ate.translation, 100))
    if evaluation.rpe is not None:
        frames = f"{evaluation.rpe.delta} frame" + "s" * (evaluation.rpe.delta > 1)
        table.add_row(f"RPE, {frames} [cm]", *_numbers(evaluation.rpe.translation, 100))
        table.add_row(f"RPE, {frames} [deg]", *_numbers(evaluation.rpe.rotation, 1))
    return table


def _numbers(statistics: Statistics, scale: float) -> list[str]:
    return [f"{value * scale:.3f}" for value in (statistics.rmse, statistics.mean, statistics.median, statistics.max)]


def _mesh_table(evaluation: Evaluation) -> Table:
    mesh = evaluation.mesh
    assert mesh is not None
    table = Table(
        "accuracy [cm]", "completion [cm]", "completion ratio, 5 cm [%]", "depth L1 [cm]", title=f"mesh, protocol {mesh.protocol}"
    )
    depth = "-" if mesh.depth_l1 is None else f"{mesh.depth_l1 * 100:.2f}"
    table.add_row(f"{mesh.accuracy * 100:.2f}", f"{mesh.completion * 100:.2f}", f"{mesh.completion_ratio * 100:.1f}", depth)
    return table
