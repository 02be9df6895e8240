"""The errors of an evaluation as a table for the console."""

from rich.markup import escape
from rich.table import Table

from idfslam.evaluation.evaluation import Evaluation
from idfslam.evaluation.mesh_error import MeshError


def table(evaluation: Evaluation) -> Table:
    """A table in centimetres, degrees and per cent."""
    result = Table(title=f"{evaluation.frames} frames", title_justify="left")
    for column in ("error", "RMSE", "mean", "median", "max", "std"):
        result.add_column(column, justify="left" if column == "error" else "right")
    rows = [(f"ATE [cm], {len(evaluation.ate.frames)} frames", evaluation.ate.translation, 100.0)]
    for rpe in evaluation.rpe:
        frames = "1 frame" if rpe.delta == 1 else f"{rpe.delta} frames"
        rows += [(f"RPE over {frames} [cm]", rpe.translation, 100.0), (f"RPE over {frames} [deg]", rpe.rotation, 1.0)]
    for name, s, unit in rows:
        result.add_row(escape(name), *(f"{value * unit:.3f}" for value in (s.rmse, s.mean, s.median, s.max, s.std)))
    if evaluation.mesh is not None:
        result.add_section()
        for name, text in _mesh_rows(evaluation.mesh):
            result.add_row(escape(f"{name}, protocol {evaluation.mesh.protocol}"), "", text)
    return result


def _mesh_rows(mesh: MeshError) -> list[tuple[str, str]]:
    rows = [
        ("accuracy [cm]", f"{mesh.accuracy * 100:.2f}"),
        ("completion [cm]", f"{mesh.completion * 100:.2f}"),
        ("completion ratio < 5 cm [%]", f"{mesh.completion_ratio * 100:.1f}"),
    ]
    if mesh.depth_l1 is not None and mesh.depth_missing is not None:
        rows += [("depth L1 [cm]", f"{mesh.depth_l1 * 100:.2f}"), ("depth missing [%]", f"{mesh.depth_missing * 100:.1f}")]
    rows.append(("depth read [m]" if mesh.range_from == "recording" else "depth [m]", f"{mesh.near:.2f} to {mesh.far:.2f}"))
    return rows
